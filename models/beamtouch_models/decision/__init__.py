"""The meaning of a model's answers: rest, one contact, or something that neither explains. Numpy only, and pure.

`evidence` weighs samples under a model; a `Decider` takes the evidence of consecutive samples and keeps the state;
`Hypotheses` are several of them, where samples are missing; `Suspects` names the channel without which everything is
explained, and `Wirings` the cables that are swapped.
"""

from beamtouch_models.decision.decider import Decider, Memory, State, Verdict
from beamtouch_models.decision.doubts import is_odd, is_overload, is_unchecked
from beamtouch_models.decision.evidence import LOG_ODDS, MISFIT, Evidence, Weighed, evidence
from beamtouch_models.decision.hypotheses import Hypotheses, Judgement, memories_after
from beamtouch_models.decision.suspects import SAMPLES, LeftOut, Suspects
from beamtouch_models.decision.wiring import Wiring, Wirings, wirings

__all__ = [
    "LOG_ODDS",
    "MISFIT",
    "SAMPLES",
    "Decider",
    "Evidence",
    "Hypotheses",
    "Judgement",
    "LeftOut",
    "Memory",
    "State",
    "Suspects",
    "Verdict",
    "Weighed",
    "Wiring",
    "Wirings",
    "evidence",
    "is_odd",
    "is_overload",
    "is_unchecked",
    "memories_after",
    "wirings",
]
