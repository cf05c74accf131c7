"""Requests that cannot be: a command says in one line what is wrong, exits with 2, and writes nothing."""

from pathlib import Path

import pytest

from beamtouch_models import cli
from support.programs.in_process import command_of
from support.surfaces.example_scenes import PAPER

BUILD, EVALUATE, TRADE = "build scene.toml -o m.onnx", "evaluate bench.onnx", "trade scene.toml -o out"
CALIBRATE, SIZE = "calibrate bench.onnx loads.csv", "--length-mm 650 --width-mm 40 --thickness-mm"
PRODUCT = ("--criterion eigenvalue-product", "--components 2")
EFFORTS = ("0", "-1", "nan", "1000")
REQUESTS = [
    ("", "the following arguments are required: COMMAND"),
    ("guess", "argument COMMAND: invalid choice: 'guess' (choose from build, "),
    ("build half.onnx -o new.onnx", "not a model file that holds its scene"),
    (f"{BUILD} --report a/b.html", "a: no such folder"),
    ("build absent.toml -o m.onnx", "absent.toml"),
    (f"place scene.toml --seed {'9' * 5000}", "is not a whole number from 0 to 4294967295"),
    (f"{EVALUATE} --noise -1", "--noise -1"),
    (f"{EVALUATE} --noise nan", "--noise nan"),
    (f"{EVALUATE} --noise 1e300", "hides the largest deflection"),
    (f"{EVALUATE} --noise 1e-9", "less than 1e-4 % of the largest deflection"),
    (f"{EVALUATE} --draws 5", "from 100"),
    (f"{EVALUATE} --draws 1000001", "to 1000000"),
    ("challenge", "required: MODEL"),
    ("challenge absent.onnx --draws 9", "from 10 to 10000"),
    (f"{TRADE} --latency-ms 0", "--latency-ms 0: give a positive number"),
    (f"{TRADE} --error-mm nan", "--error-mm nan: give a positive number"),
    (f"{TRADE} --error-mm 1 --latency-ms 1", "not allowed with argument --error-mm"),
    *(
        (
            f"place scene.toml {by} --failed-percent 5",
            "failed_percent = 5: it weighs position errors, and goes with no other",
        )
        for by in PRODUCT
    ),
    *(
        (f"{command} --effort {effort}", f"effort = {effort} is not from 0.01 to 100")
        for command, effort in (
            (BUILD, "0"),
            ("explain scene.toml", "-1"),
            ("place scene.toml", "nan"),
            (TRADE, "1000"),
        )
    ),
    ("calibrate bench.onnx -o new.onnx", "READINGS.csv"),
    (f"{CALIBRATE} --events contacts.csv -o new.onnx", "READINGS.csv"),
    (f"{CALIBRATE} -o absent/real.onnx", "absent: no such folder; create it first"),
    (f"{CALIBRATE} -o new.onnx --placing-mm 0", "--placing-mm 0 is not from 0.001 to 50"),
    (f"{CALIBRATE} -o new.onnx --placing-mm nan", "--placing-mm nan is not from 0.001 to 50"),
    (f"{CALIBRATE} -o new.onnx --force-percent 1e9", "--force-percent 1e+09 is not from 0.001 to 50"),
    ("reproduce -o scene.toml", "is a file; give a folder"),
    ("scenes --copy papr", "choose from bench, "),
    ("scenes --copy paper a b", "b is one too many"),
    ("new a.toml", "arguments are required: --length-mm, --width-mm, --thickness-mm"),
    (f"new a.txt {SIZE} 2", "a.txt: give the scene a name that ends in .toml"),
    (f"new a.toml {SIZE} 0.002", "beam.thickness_mm = 0.002 is too small for a beam; if it"),
    (f"new a.toml {SIZE} nan", "--thickness-mm nan: give millimetres, more than 0"),
    (f"new a.toml {SIZE} 2 --left free", "--left free --right roller: supports: one simple support lets"),
    (f"new a.toml {SIZE} 2 --roller-mm 650", "--right roller --roller-mm 650: supports at [0.0, 650.0, 650.0] mm: two"),
    (f"new a.toml {SIZE} 2 --roller-mm nan", "--roller-mm nan: must be a finite number"),
    (f"new a.toml {SIZE} 2 --force-n 1 1e6", "at 1e+06 N the beam slopes by"),
    (f"new a.toml {SIZE} 2 --position-mm 60 700", "--position-mm 60 700: give two places on the beam, 0..650 mm"),
    (f"new a.toml {SIZE} 2 --range-mm 4 1", "--range-mm 4 1: give two gaps in mm, the smaller one first"),
    (f"new a.toml {SIZE} 2 --material steal", "invalid choice: 'steal' (choose from steel, "),
    *(
        (f"{command} FILE {options}", said)
        for command in ("trade", "evaluate", "challenge")
        for options, said in (
            ("--workers 0", "'0' is not a whole number from 1 to 1024"),
            ("--workers 2 --cluster tcp://127.0.0.1:1", "not allowed with argument --workers"),
            ("--cluster 127.0.0.1:8786", "'127.0.0.1:8786' is not tcp://HOST:PORT"),
            ("--cluster tcp://127.0.0.1:high", "is not tcp://HOST:PORT"),
        )
    ),
]


@pytest.mark.parametrize(("request_", "said"), REQUESTS)
def test_a_wrong_request_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str],
    bench_model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request_: str,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    model = bench_model.read_bytes()
    Path("bench.onnx").write_bytes(model)
    Path("half.onnx").write_bytes(model[: len(model) // 2])
    Path("scene.toml").write_text(PAPER)
    before = sorted(tmp_path.iterdir())
    done = command_of(cli.main, capsys)(*request_.split())
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert said in done.stderr
    assert sorted(tmp_path.iterdir()) == before
