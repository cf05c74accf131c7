"""Any number of listeners hear of a surface; none takes the place of another."""

from beamtouch_service.surfaces.listeners import Listeners
from beamtouch_service.surfaces.surface import Surface
from service.bench import Bench, surface_of


def test_each_listener_is_told_of_each_batch_that_moves_the_answer() -> None:
    surface, told = surface_of(), list[tuple[str, str]]()
    surface.moves.add(lambda moved: told.append(("first", moved.name)))
    surface.moves.add(lambda moved: told.append(("second", moved.name)))
    bench = Bench(surface)

    bench.send(sequence=1)
    bench.send(sequence=1)  # a copy moves nothing

    assert told == [("first", "press-7"), ("second", "press-7")]


def test_the_metrics_and_others_hear_of_runs_and_arrivals() -> None:
    surface, runs, ages = surface_of(), list[float](), list[float]()
    surface.runs.add(runs.append)
    surface.arrivals.add(ages.append)
    bench = Bench(surface)

    bench.send(age_ms=40.0)

    assert len(runs) == 1
    assert ages == [0.04]
    text = bench.metrics()
    assert 'beamtouch_inference_seconds_count{surface="press-7"} 1.0' in text
    assert 'beamtouch_sample_arrival_age_seconds_sum{surface="press-7"} 0.04' in text


def test_a_listener_of_a_block_hears_nothing_after_it() -> None:
    listeners, told = Listeners[int](), list[str]()
    listeners.add(lambda value: told.append(f"always {value}"))
    with listeners.told(lambda value: told.append(f"within {value}")):
        listeners.tell(1)
    listeners.tell(2)
    assert told == ["always 1", "within 1", "always 2"]


def test_a_listener_that_leaves_while_it_is_told_keeps_no_other_from_hearing() -> None:
    surface, told = surface_of(), list[str]()

    def leave(_moved: Surface) -> None:
        leaving.__exit__(None, None, None)

    leaving = surface.moves.told(leave)
    leaving.__enter__()
    surface.moves.add(lambda _moved: told.append("heard"))
    Bench(surface).send()
    assert told == ["heard"]
