"""From decisions on samples in a row to pieces of contacts, and to what they say of the pieces beside them. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass

from beamtouch_service.events.pieces import Begin, End, GrowingPiece, Piece
from beamtouch_service.surfaces.contact import Decision, State
from beamtouch_service.surfaces.touch import Seen

FLUSH_US = 1_000_000
"""A piece of a contact that goes on is handed over after this much of the sender's time, so that a crash costs no
more."""


@dataclass(frozen=True)
class Finish:
    """The contact whose last sample is number `last_sequence` ended."""

    boot_id: str
    last_sequence: int
    end: End
    lifted_us: int | None = None


@dataclass(frozen=True)
class TouchSeen:
    """A contact whose first sample is number `first_sequence` began with it: the one before was clear."""

    boot_id: str
    first_sequence: int


@dataclass(frozen=True)
class Loss:
    """Something of this surface is not on record: what is open there ends unseen."""


Command = Piece | Finish | TouchSeen | Loss


class Folder:
    """Folds the samples of one surface, sender and model, in the order of their numbers.

    `end` is the end of a piece as long as nothing else is known: late samples never open an event.
    """

    def __init__(
        self, surface: str, model: str, boot_id: str, before: State | None = None, end: End = End.OPEN
    ) -> None:
        self.last: tuple[int, int, State | None] | None = None
        """Number, time and state of the last sample."""
        self._surface, self._model, self.boot_id = surface, model, boot_id
        self._pending: GrowingPiece | None = None
        self._end = end
        self._in_contact = False
        self._is_expired = False
        """The contact ended as stale; it goes on if the next sample follows."""
        self._was_clear = before is State.CLEAR

    def add(self, seen: Seen) -> list[Command]:
        """Take the next sample."""
        number = seen.estimated.sequence
        commands: list[Command] = []
        if self.last and number != self.last[0] + 1:
            commands += self.interrupt()
        if seen.state is State.CLEAR:
            commands += self._clear(seen)
        elif seen.state is State.CONTACT or (seen.touching and self._in_contact):
            commands += self._contact(seen)
        else:
            commands += self.interrupt()
        self.last = number, seen.estimated.acquired_unix_us, seen.state
        return commands

    def flush(self) -> list[Command]:
        """Hand over what there is of a contact that goes on."""
        pending, self._pending = self._pending, None
        return [pending.piece()] if pending else []

    def expire(self) -> list[Command]:
        """Note that no sample has come for too long."""
        commands = self.flush()
        if self._in_contact and self.last:
            commands.append(Finish(self.boot_id, self.last[0], End.STALE))
            self._is_expired = True
        return commands

    def interrupt(self) -> list[Command]:
        """Note that what comes next is not known, or does not follow."""
        commands = self.flush()
        if self._in_contact and self.last:
            commands.append(Finish(self.boot_id, self.last[0], End.UNSEEN))
        self._in_contact = self._was_clear = False
        return commands

    def _clear(self, seen: Seen) -> list[Command]:
        commands = self.flush()
        number, time_us = seen.estimated.sequence, seen.estimated.acquired_unix_us
        first_of_run = self.last is None or number != self.last[0] + 1
        if self._in_contact or first_of_run:
            commands.append(Finish(self.boot_id, number - 1, End.LIFT, time_us))
        self._in_contact, self._was_clear = False, True
        return commands

    def _contact(self, seen: Seen) -> list[Command]:
        number, time_us = seen.estimated.sequence, seen.estimated.acquired_unix_us
        figures = seen.outcome.figures if isinstance(seen.outcome, Decision) else None
        is_new, degraded = not self._in_contact, bool(seen.estimated.bad) or figures is None
        begin = Begin.TOUCH if is_new and self._was_clear else Begin.UNSEEN
        if self._pending is None:
            self._pending = GrowingPiece(
                Piece(
                    self._surface,
                    self._model,
                    self.boot_id,
                    number,
                    number,
                    time_us,
                    time_us,
                    begin=begin,
                    end=self._end,
                )
            )
        self._pending.add(number, time_us, figures, degraded=degraded)
        self._in_contact, self._was_clear = True, False
        # At once when it begins or goes on again, so that it is on record; then now and then.
        due = is_new or self._is_expired or self._pending.duration_us >= FLUSH_US
        self._is_expired = False
        return self.flush() if due else []


def fold_late(folder: Folder, run: Iterable[Seen], after: tuple[int, State | None] | None) -> list[Command]:
    """Return what a run of late samples without a gap comes to.

    `after` is time [us] and state of the sample that follows the run, where that is known.
    """
    commands = [command for seen in run for command in folder.add(seen)]
    if folder.last is None:
        return commands
    number, _, state = folder.last
    commands += folder.interrupt()
    if state is State.CLEAR:
        commands.append(TouchSeen(folder.boot_id, number + 1))
    elif after and after[1] is State.CLEAR:
        commands.append(Finish(folder.boot_id, number, End.LIFT, after[0]))
    return commands
