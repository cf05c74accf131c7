"""When a channel is out, and back again: by the time in which it was not good."""

from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.channels import ChannelOut, ChannelsOut, ChannelTransition

AFTER_S = 2.0
MISSING, STUCK = Quality.MISSING, Quality.STUCK
SINCE_US = 1_795_218_046_123_456
SINCE = "2026-11-20T23:40:46.123Z"


def seen(*samples: tuple[float, Quality | None]) -> ChannelsOut:
    """Follow the channel s1 over samples, each with the time since the one before and what is wrong with it."""
    channels, now_us = ChannelsOut(AFTER_S), SINCE_US
    for passed_s, quality in samples:
        now_us += round(passed_s * 1e6)
        channels.add(now_us, {} if quality is None else {"s1": quality}, passed_s)
    return channels


def test_a_channel_is_out_once_it_was_not_good_for_the_stated_time() -> None:
    # The time before its first bad sample does not count.
    assert not seen((0.0, MISSING), (1.999, MISSING)).any
    channels = seen((0.0, MISSING), (1.0, MISSING), (1.0, STUCK))
    out = ChannelOut(quality=STUCK, since=SINCE)
    assert (channels.any, channels.now) == (True, {"s1": out})
    assert channels.take_transitions() == [ChannelTransition("s1", out, is_back=False)]
    assert channels.take_transitions() == []
    assert not seen((5.0, MISSING), (1.0, MISSING)).any


def test_a_channel_is_back_once_it_has_made_up_for_that() -> None:
    out = [(0.0, MISSING), (2.0, MISSING), (100.0, MISSING)]
    assert seen(*out, (1.999, None)).any
    back = seen(*out, (1.0, None), (1.0, None))
    assert (back.any, back.now) == (False, {})
    said = ChannelOut(quality=MISSING, since=SINCE)
    assert back.take_transitions() == [
        ChannelTransition("s1", said, is_back=False),
        ChannelTransition("s1", said, is_back=True),
    ]


def test_a_channel_that_is_good_half_of_the_time_is_not_told() -> None:
    channels = seen(*[(1.0, MISSING), (1.0, None)] * 50)
    assert (channels.any, channels.take_transitions()) == (False, [])
    assert seen((0.0, MISSING), *[(1.0, MISSING), (0.9, None)] * 12).any
    # A spell that is over counts for nothing.
    assert not seen((0.0, MISSING), (1.5, MISSING), (1.5, None), (0.0, MISSING), (1.0, MISSING)).any


def test_with_another_model_it_begins_anew() -> None:
    channels = seen((0.0, MISSING), (1.5, MISSING))
    channels.forget()
    channels.add(SINCE_US, {"s1": MISSING}, 1.5)
    assert not channels.any
