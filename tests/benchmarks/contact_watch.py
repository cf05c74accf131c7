"""Asks for the contacts of one surface, and holds them against the truth of its rig."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import httpx2

from line import Line, Truth

STALE_MS = 500.0
SETTLED_S = 0.2
"""A contact counts if the load was the same for this long before its sample."""
ANSWERED_S = 0.5
"""The same after its sample, which is as old as the request for its last reading: a rig may have answered later."""
HIDDEN_S = 0.2
"""What a sample may be older than stated: a pause of the service, and a connection of HAProxy, of 0.1 s each."""
_WAIT_S = 2.0
"""Contacts are compared after this time, once the rig has written what followed."""


@dataclass
class Watched:
    """What asking for one surface showed."""

    asked: int = 0
    problems: Counter[str] = field(default_factory=Counter)
    """By type, without what all have in common."""
    gaps_s: dict[str, float] = field(default_factory=dict)
    """Longest time between two contacts, by what was disturbed at the end of it."""
    compared: int = 0
    outside: int = 0
    """The truth outside of the stated interval."""
    unexplained: int = 0
    """Answers that neither rest nor one contact explains the sample, though it does."""
    mistakes: list[dict[str, Any]] = field(default_factory=list)
    """Contacts where nothing touched, or the other way round."""
    too_old: list[dict[str, Any]] = field(default_factory=list)
    """Contacts beyond their limit when they were asked for: there must be none."""


def nothing() -> str:
    """Return what is disturbed where nothing is."""
    return ""


def watch(
    line: Line, name: str, stop: threading.Event, seen: Watched, ask_s: float, disturbed: Callable[[], str] = nothing
) -> None:
    """Ask for one surface until told to stop; `disturbed` says what is disturbed at the moment."""
    truth = Truth(line.truth(name))
    answered_s = time.monotonic()
    waiting: deque[tuple[float, str, dict[str, Any]]] = deque()
    with httpx2.Client(base_url=line.url, trust_env=False, timeout=1.0) as client:
        while not stop.wait(ask_s):
            seen.asked += 1
            asked_unix_s = time.time()
            truth.read()
            while waiting and waiting[0][0] < time.monotonic() - _WAIT_S:
                _compare(*waiting.popleft()[1:], truth, seen)
            try:
                response = client.get(f"/contact?surface={name}")
            except httpx2.TransportError:
                seen.problems["no answer"] += 1
                continue
            if not response.is_success:
                seen.problems[response.text.partition("urn:beamtouch:problem:")[2].partition('"')[0]] += 1
                continue
            now_s, contact = time.monotonic(), response.json()
            gap_s, answered_s = now_s - answered_s, now_s
            seen.gaps_s[disturbed()] = max(seen.gaps_s.get(disturbed(), 0.0), gap_s)
            # A replica that was frozen must not give an old sample for a new one. Daemon and rigs have this clock.
            true_age_s = asked_unix_s - datetime.fromisoformat(contact["sampled_at"]).timestamp()
            if contact["age_ms"] > STALE_MS or true_age_s > STALE_MS / 1e3 + HIDDEN_S:
                seen.too_old.append({**contact, "true_age_s": true_age_s, "disturbed": disturbed()})
            waiting.append((now_s, disturbed(), contact))
    truth.close()


def _compare(disturbed: str, contact: dict[str, Any], truth: Truth, seen: Watched) -> None:
    """Hold a contact against the truth where that stands still."""
    moment = datetime.fromisoformat(contact["sampled_at"]).timestamp()
    load = truth.at(moment)
    if load is None or not truth.steady(moment, SETTLED_S) or not truth.steady(moment + ANSWERED_S, ANSWERED_S):
        return
    seen.compared += 1
    if contact["state"] == "unexplained":
        seen.unexplained += 1
    elif (load[0] is not None) != (contact["state"] == "contact"):
        seen.mistakes.append({**contact, "truth_mm": load[0], "truth_n": load[1], "disturbed": disturbed})
    elif load[0] is not None:
        seen.outside += not contact["position_low_mm"] <= load[0] <= contact["position_high_mm"]
