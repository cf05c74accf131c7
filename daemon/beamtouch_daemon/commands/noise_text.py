"""The output of `noise`: a table with the lines to paste, and the same as JSON."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from beamtouch_common.digits import digits
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import Adaptive, LowPass, MovingAverage
from beamtouch_daemon.processing.noise_keys import Keys
from beamtouch_daemon.processing.rest_noise import ChannelNoise


@dataclass(frozen=True)
class Measured:
    """The noise of a surface."""

    surface: str
    settings: Surface
    readings: int
    lost: int
    seconds: float
    channels: Sequence[ChannelNoise]
    keys: Keys

    @property
    def filter(self) -> str:
        """The configured filter, for which the effective noise is stated."""
        chosen = self.settings.filter
        if isinstance(chosen, MovingAverage):
            return f"the mean of {chosen.window} readings"
        if isinstance(chosen, Adaptive):
            return f"an adaptive mean of up to {chosen.window} readings"
        if isinstance(chosen, LowPass):
            return f"a low-pass of {chosen.cutoff_hz:g} Hz"
        return "single readings"

    def correlation_ms(self, channel: ChannelNoise) -> float:
        """Return the time after which a reading counts as independent; a period for white noise."""
        return 1e3 * channel.correlated_readings / self.settings.rate_hz


def as_json(found: Measured) -> dict[str, object]:
    """Return the content of the JSON object for one surface."""
    keys = found.keys
    scene = {"noise_mm": keys.scene_noise_mm, "zero_drift_mm": keys.zero_drift_mm}
    return {
        "error": None,
        "readings": found.readings,
        "readings_lost": found.lost,
        "seconds": found.seconds,
        "filter": found.filter,
        "channels": [
            {
                "channel": one.channel,
                "noise_mm": one.noise_mm,
                "correlation_ms": found.correlation_ms(one),
                "effective_noise_mm": one.effective_noise_mm,
                "drift_mm": one.drift_mm,
                "step_mm": one.step_mm,
                "steps_hide_noise": one.is_rounded,
            }
            for one in found.channels
        ],
        "daemon": {"noise_mm": keys.daemon_noise_mm, "stuck_after_ms": keys.stuck_after_ms},
        "scene": scene if keys.adc_bits is None else scene | {"adc_bits": keys.adc_bits},
    }


def lines(answers: Sequence[Measured]) -> list[str]:
    """Return the lines for people: a table of all channels, then the lines to paste for each surface."""
    rows = [("surface", "channel", "noise mm", "correlation ms", "effective mm", "drift mm", "step mm")]
    rows += [
        (
            found.surface,
            one.channel,
            digits(one.noise_mm, 3),
            digits(found.correlation_ms(one), 3),
            digits(one.effective_noise_mm, 3),
            digits(one.drift_mm, 2),
            digits(one.step_mm, 3) if one.step_mm else "-",
        )
        for found in answers
        for one in found.channels
    ]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    table = [
        "  ".join(
            cell.rjust(width) if at > 1 else cell.ljust(width)
            for at, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    return [*table, *(line for found in answers for line in _paste(found))]


def _paste(found: Measured) -> list[str]:
    keys = found.keys
    lost = f", {found.lost} lost" if found.lost else ""
    taken = f"{found.readings} readings in {digits(found.seconds, 3)} s{lost}"
    return [
        "",
        f"{found.surface}: {taken}; effective noise for {found.filter}",
        *_remarks(found),
        "",
        f"[surfaces.{json.dumps(found.surface)}]        # in the daemon's configuration",
        f"noise_mm = {keys.daemon_noise_mm!r}",
        *(
            f"stuck_after_ms = {time!r}        # under the channel {channel}: noise_mm would call it stuck"
            for channel, time in keys.stuck_after_ms.items()
        ),
        "",
        "[sensors]        # in the scene, without noise_percent_of_max; then build the model again",
        f"noise_mm = {keys.scene_noise_mm!r}",
        f"zero_drift_mm = {keys.zero_drift_mm!r}        # within such a time; zeros drift further in a longer one",
        *([] if keys.adc_bits is None else [f"adc_bits = {keys.adc_bits}"]),
    ]


def _remarks(found: Measured) -> list[str]:
    hidden = [one.channel for one in found.channels if one.is_rounded]
    alike = [one for one in found.channels if one.is_coloured]
    said = []
    if hidden:
        said.append(
            f"  {', '.join(hidden)}: the ADC's steps hide the noise, so a mean stays as wrong as a reading; "
            "a finer ADC or more noise would help"
        )
    if alike:
        times = max(one.effective_noise_mm / one.noise_mm for one in alike)
        said.append(
            f"  {', '.join(one.channel for one in alike)}: successive readings are alike, so {found.filter} is up to "
            f"{digits(times, 2)} times as noisy as with white noise"
        )
    return said
