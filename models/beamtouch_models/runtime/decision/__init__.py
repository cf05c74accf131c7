"""The meaning of a model's answers: rest, one contact, or something that neither explains. Numpy only, and pure.

`evidence` weighs samples under a model; `decide` takes the evidence of a sample and the memory of those before;
`Hypotheses` are several memories, where samples are missing. In `wrong_channels`, `Suspects` names the channel without
which everything is explained, and `Wirings` the cables that are swapped.
"""
