"""Examples for the OpenAPI description."""

import json

from beamtouch_service.problems import Kind, Problem

CONTACT = {
    "surface": "press-7",
    "state": "contact",
    "position_mm": 123.4,
    "position_low_mm": 121.9,
    "position_high_mm": 125.0,
    "force_n": 9.8,
    "force_low_n": 9.5,
    "force_high_n": 10.1,
    "age_ms": 12.3,
    "sampled_at": "2026-11-20T23:40:46.123Z",
    "sequence": 4711,
    "readings": 40,
    "misfit": 1.8,
    "quality": "good",
    "degraded_channels": [],
    "notes": [],
    "model": "paper@4f2c91",
}
_FIGURES = [name for name in CONTACT if name.startswith(("position_", "force_"))]
CLEAR = CONTACT | dict.fromkeys(_FIGURES) | {"state": "clear"}
UNEXPLAINED = CLEAR | {"state": "unexplained", "misfit": 412.7, "notes": ["check-s3"]}
DEGRADED = CONTACT | {"quality": "degraded", "degraded_channels": ["s3"], "notes": ["degraded"]}

STATE = {
    "surface": "press-7",
    "contact": CLEAR,
    "problem": None,
    "misfit_limit": 37.3,
    "age_ms": 12.3,
    "channels": [{"name": "s1", "position_mm": 100.0, "deflection_mm": 0.0, "quality": "good"}],
    "length_mm": 400.0,
    "sequence": 4711,
}
STATE_EVENT = f"event: state\ndata: {json.dumps(STATE)}\n\n"
"""One event of the stream."""

BEAM = {
    "model": "paper@4f2c91",
    "length_mm": 400.0,
    "drawn": {
        "supports": [{"at_mm": 0.0, "kind": "simple"}, {"at_mm": 400.0, "kind": "simple"}],
        "at_mm": [0.0, 200.0, 400.0],
        "load_mm": [100.0, 200.0, 300.0],
        "deflection_mm_per_n": [[0.0, 0.07778, 0.0], [0.0, 0.1131, 0.0], [0.0, 0.07778, 0.0]],
    },
}

BATCH = {
    "boot_id": "6f1d2c84-0b7e-4a53",
    "channels": ["s1", "s2", "s3"],
    "newest_age_ms": 3.2,
    "samples": [
        {
            "sequence": 4711,
            "acquired_unix_us": 1795218046123000,
            "deflection_mm": [0.112, 0.243, None],
            "quality": ["good", "good", "missing"],
            "readings": 40,
        }
    ],
}

BEST_CSV = (
    "event,time,model,characteristic,readings,s1_mm,s2_mm,s1_sd_mm,s2_sd_mm,s1_rest_mm,s2_rest_mm,s1_rest_sd_mm,"
    "s2_rest_sd_mm\r\n"
    "42,2026-11-20T23:40:46.893Z,paper@4f2c91,5c1d90aa,40,0.1120310000,0.2431870000,0.0007140000,0.0007140000,"
    "0.0001120000,-0.0000870000,0.0003570000,0.0003570000\r\n"
)
"""A best sample of two channels."""

EVENT = {
    "id": 42,
    "surface": "press-7",
    "kind": "contact",
    "touched_at": "2026-11-20T23:40:46.123Z",
    "lifted_at": "2026-11-20T23:40:47.373Z",
    "begin": "touch",
    "end": "lift",
    "dwell_ms": 1250.0,
    "unexplained_ms": 0.0,
    "peak_force_n": 9.8,
    "peak_position_mm": 123.4,
    "mean_position_mm": 123.1,
    "samples": 250,
    "unsteady": False,
    "quality": "good",
    "model": "paper@4f2c91",
    "boot_id": "6f1d2c84-0b7e-4a53",
}
_OF_CONTACT = ["peak_force_n", "peak_position_mm", "mean_position_mm"]
STRETCH = EVENT | dict.fromkeys(_OF_CONTACT) | {"kind": "unexplained", "begin": "clear", "end": "clear", "samples": 0}
STRETCH |= {"unexplained_ms": 1250.0}
_CAPTURE = [
    {
        "sequence": 4711,
        "sampled_at": "2026-11-20T23:40:46.123Z",
        "readings": 40,
        "misfit": 412.7,
        "misfit_limit": 27.6,
        "rest_misfit": 15231.0,
        "rest_limit": 37.3,
        "log_odds": 7409.2,
        "channels": [
            {
                "name": "s3",
                "deflection_mm": 0.497,
                "standard_error_mm": 0.0004,
                "rest_residual": 331.3,
                "misfit_without": 1.9,
                "rest_misfit_without": 2.4,
                "explained_without": True,
            }
        ],
    }
]
_PATH = [{"at": "2026-11-20T23:40:46.123Z", "position_mm": 123.4, "force_n": 9.8}]
EVENT_WITH_PATH = EVENT | {"path": _PATH, "capture": []}
STRETCH_WITH_PATH = STRETCH | {"path": [], "capture": _CAPTURE}
NEXT = "1795218046123000.42"
CSV = "\r\n".join([",".join(EVENT), ",".join(json.dumps(value).strip('"') for value in EVENT.values()), ""])

PROBLEMS = {
    Kind.STALE: Problem(
        Kind.STALE,
        "The newest sample is 2140.7 ms old; the limit is 500 ms. Check that the daemon runs and reaches the device.",
        "press-7",
        {"age_ms": 2140.7, "stale_ms": 500.0},
    ),
    Kind.TOO_FEW_CHANNELS: Problem(
        Kind.TOO_FEW_CHANNELS,
        "Only 1 channel works; the model needs 2. Check s2 (stuck), s3 (missing).",
        "press-7",
        {"bad_channels": {"s2": "stuck", "s3": "missing"}},
    ),
    Kind.MISSING_CHANNELS: Problem(
        Kind.MISSING_CHANNELS,
        "The batch lacks s3. Send every channel of the model; mark a broken one as missing.",
        "press-7",
        {"missing_channels": ["s3"]},
    ),
    Kind.INVALID_REQUEST: Problem(
        Kind.INVALID_REQUEST,
        "#/newest_age_ms: Input should be greater than or equal to 0",
        members={
            "errors": [{"pointer": "#/newest_age_ms", "detail": "Input should be greater than or equal to 0"}],
        },
    ),
}
