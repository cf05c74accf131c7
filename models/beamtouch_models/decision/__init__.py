"""The meaning of a model's answers: rest, one contact, or something that neither explains. Numpy only, and pure.

`evidence` weighs samples under a model; a `Decider` takes the evidence of consecutive samples and keeps the state;
`Hypotheses` are several of them, where samples are missing; `Suspects` names the channel without which everything is
explained, and `Wirings` the cables that are swapped.
"""
