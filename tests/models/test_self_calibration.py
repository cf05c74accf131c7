"""Self-calibration: gains and positions from contacts of unknown place and force, beside the true ones."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.accuracy import limit
from beamtouch_models.calibration.calibrate import calibrate
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.left_open import LeftOpen
from beamtouch_models.calibration.loads import read_loads
from beamtouch_models.calibration.self_calibrate import KINDS, SelfCalibrated, self_calibrate
from beamtouch_models.calibration.theory import GAIN, Theory
from beamtouch_models.calibration.unlabelled import fit_contacts
from beamtouch_models.estimators.onnx_graph import to_bytes, with_force_error
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.progress import Progress, silent
from beamtouch_models.rig.surface import Imperfections
from beamtouch_models.session import runner
from beamtouch_models.surface import prior_of_model
from few_draws import few_draws
from imperfect_surface import imperfections, readings, true_prior
from in_process import Command
from posterior_cases import graph_of
from unlabelled_contacts import OFF, Kind, drawn, fitted, missed_mm, random_contacts, write_contacts

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def found(bench: ModelFile) -> tuple[SelfCalibrated, Imperfections]:
    """The bench's model from 200 contacts, of which a tenth are two at once."""
    contacts, real = random_contacts(bench, dataclasses.replace(OFF, two_at_once=0.1), 3)
    with few_draws():
        return self_calibrate(bench, contacts, silent), real


def test_200_contacts_bring_the_error_to_the_limit(
    bench: ModelFile, found: tuple[SelfCalibrated, Imperfections]
) -> None:
    calibrated, real = found
    model = modelfile.load_bytes(calibrated.content, "calibrated")  # its golden answers come out
    prior = true_prior(bench.metadata, real)
    fresh = limit.draw(prior, 1500, 9)
    reading = prior.measured(fresh.deflection_mm)
    best = np.abs(limit.posterior_median_mm(prior, fresh.deflection_mm) - fresh.position_mm).mean()

    def seen(one: ModelFile) -> dict[str, np.ndarray]:
        return one.estimate(
            reading.astype(np.float32), prior_of_model(one.metadata).whitening(reading).astype(np.float32)
        )

    before, after = (seen(one) for one in (bench, model))
    assert np.abs(before["position_mm"] - fresh.position_mm).mean() > 2 * best
    # Over random surfaces the ratio is 1.04 on average; this one is among the worst.
    assert np.abs(after["position_mm"] - fresh.position_mm).mean() < 1.4 * best
    held = (after["position_low_mm"] <= fresh.position_mm) & (fresh.position_mm <= after["position_high_mm"])
    # The errors of one surface go together: over surfaces 98 % are held, on this one 93 %.
    assert 0.9 < held.mean() < 0.999
    # Nothing shows the scale of the forces, and the intervals say so.
    forces = (after["force_low_n"] <= fresh.force_n) & (fresh.force_n <= after["force_high_n"])
    assert forces.mean() > 0.9
    assert calibrated.metadata.calibration is not None
    assert 0.003 < calibrated.metadata.calibration.force_error < 0.03


def test_the_file_says_what_was_fitted(bench: ModelFile, found: tuple[SelfCalibrated, Imperfections]) -> None:
    metadata = modelfile.load_bytes(found[0].content, "calibrated").metadata
    assert metadata.beam == bench.metadata.beam
    calibration = metadata.calibration
    assert calibration is not None
    assert (calibration.loads, calibration.contacts, calibration.error_after_mm) == (0, 200, None)
    assert calibration.fitted == ["gain", "position", "curve", "offset"]
    assert calibration.misfit_before is not None
    assert calibration.misfit_after is not None
    assert calibration.misfit_after < 0.3 * calibration.misfit_before
    assert metadata.floor.zero_mm == bench.metadata.floor.zero_mm
    assert metadata.floor.gain == pytest.approx(found[0].found.left_open.floor().tolist())


def test_the_errors_of_positions_are_as_stated(bench: ModelFile) -> None:
    theory, ratios = Theory.of(bench.metadata), []
    zero_mm = np.array(bench.metadata.floor.zero_mm)
    noise_mm = np.hypot(bench.metadata.noise.sample_mm, zero_mm)
    for seed in range(12):
        contacts, real = random_contacts(bench, OFF, seed)
        one = fit_contacts(theory, np.zeros(theory.size), contacts, KINDS, zero_mm)
        open_mm = LeftOpen(one, one.covariance, noise_mm).position_mm
        ratios.append(missed_mm(theory, one.vector, bench.metadata, real) / np.sqrt(2 / np.pi) / open_mm.mean())
    # The errors of one surface go together, so each is one draw, of which 12 have a root mean square of 1 +- 0.2.
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.4


def test_hinged_ends_are_not_refused(bench: ModelFile) -> None:
    assert all(fitted(bench, OFF, seed)[0].fit.left_error < 1e-3 for seed in range(2))


def test_a_known_force_is_used(built_model: Callable[[str], Path]) -> None:
    model = modelfile.load(built_model("paper"))
    kind = Kind(gain=0.02)
    one, real = fitted(model, kind, 2)
    theory = one.fit.theory
    assert theory.prior.force_is_known
    # With the force, the scale of the gains is known too.
    gain = np.array(theory.departures(one.fit.vector).gain)
    errors = GAIN * one.fit.spread[theory.kinds["gain"]]
    assert gain.mean() == pytest.approx(np.mean(real.gain), abs=3 * errors.mean())


def test_what_seems_to_press_on_a_support_does_not_end_a_fit(built_model: Callable[[str], Path]) -> None:
    # Two contacts at once often look like one on the middle support, where the best force is 1e8 N.
    model = modelfile.load(built_model("two-spans"))
    one, real = fitted(model, Kind(gain=0.02, two_at_once=0.1), 2, 100)
    gain = np.array(one.fit.theory.departures(one.fit.vector).gain)
    errors = GAIN * one.fit.spread[one.fit.theory.kinds["gain"]]
    assert np.all(np.abs(gain / gain.mean() - np.array(real.gain) / np.mean(real.gain)) < 4 * errors)


@pytest.mark.usefixtures("short_measuring")
def test_it_goes_on_from_a_calibrated_model(bench: ModelFile, tmp_path: Path) -> None:
    real = imperfections(4, bench.metadata)
    first = calibrate(bench, read_loads(readings(tmp_path, bench, real), bench.metadata), silent)
    model = modelfile.load_bytes(first.content, "calibrated with loads")
    assert first.metadata.calibration is not None
    theory = Theory.of(model.metadata)
    start = theory.vector_of(first.metadata.calibration.departures)
    again = theory.departures(start)
    assert again.gain == pytest.approx(first.metadata.calibration.departures.gain)
    assert again.fixity == pytest.approx(first.metadata.calibration.departures.fixity)
    # Since the loads, one gain has fallen by 3 %.
    aged = real.model_copy(update={"gain": (real.gain[0], real.gain[1] * 0.97, *real.gain[2:])})
    contacts = drawn(model.metadata, aged, Kind(), np.random.default_rng(5), 100)
    second = self_calibrate(model, contacts, silent)
    fit, calibration = second.found.fit, second.metadata.calibration
    assert missed_mm(theory, fit.vector, model.metadata, aged) < 0.4 * missed_mm(theory, start, model.metadata, aged)
    assert calibration is not None
    assert (calibration.loads, calibration.contacts) == (10, 100)
    assert calibration.departures.fixity == pytest.approx(again.fixity)


def test_wider_forces_leave_the_rest_as_it_is(bench: ModelFile) -> None:
    graph = graph_of(prior_of_model(bench.metadata))
    plain, wide = (runner(to_bytes(one)) for one in (graph, with_force_error(graph, 0.02)))
    golden = bench.metadata.golden
    inputs = np.array(golden.deflection_mm, np.float32), np.array(golden.whitening_per_mm, np.float32)
    before, after = plain(*inputs), wide(*inputs)
    for name in before.keys() - {"force_low_n", "force_high_n"}:
        assert after[name] == pytest.approx(before[name], nan_ok=True)
    for end in ("force_low_n", "force_high_n"):
        gap = np.hypot(before[end] - before["force_n"], 1.96 * 0.02 * before["force_n"])
        assert np.abs(after[end] - before["force_n"]) == pytest.approx(gap, rel=1e-4)
    assert with_force_error(graph, 0.0) is graph


@pytest.mark.usefixtures("short_measuring")
def test_the_command_writes_a_model_and_says_what_it_changed(
    design_sensors_here: Command,
    bench_model: Path,
    bench: ModelFile,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept: list[SelfCalibrated] = []

    def once(model: ModelFile, contacts: UnlabelledContacts, progress: Progress) -> SelfCalibrated:
        kept.extend([] if kept else [self_calibrate(model, contacts, progress)])
        return kept[0]

    monkeypatch.setattr("beamtouch_models.calibration.self_calibrate.self_calibrate", once)
    contacts, _ = random_contacts(bench, OFF, 1, 100)
    path, output = write_contacts(tmp_path / "contacts.csv", bench, contacts), tmp_path / "new.onnx"
    done = design_sensors_here("calibrate", bench_model, "--events", path, "-o", output, "--json")
    assert done.returncode == 0
    told = json.loads(done.stdout)
    assert told["model"] == modelfile.load(output).identity
    assert told["misfit"]["after"] < told["misfit"]["before"]
    assert set(told["standard_errors"]) == {"gain", "position", "curve", "offset"}
    assert told["open_mm"] < told["changed_mm"]
    # The same answer once more, for people.
    plain = design_sensors_here("calibrate", bench_model, "--events", path, "-o", output)
    for word in ("gain ", "position ", "misfit ", "floor "):
        assert any(line.startswith(word) for line in plain.stdout.splitlines()), word
    shown = design_sensors_here("inspect", output)
    assert "calibrated with 100 unlabelled contacts" in shown.stdout
