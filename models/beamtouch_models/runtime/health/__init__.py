"""Changes of gains and zeros, from the contacts that a surface sees. Numpy only, and pure.

A contact of force f at x deflects the sensors by z = diag(1 + g) f G(x) + o. Position and force are unknown, so only
the part of z that neither of them explains says anything of the gain errors g. A common change of all gains is never
seen: it is force. A change that nearly is a shift of the position is hardly seen. The zeros o are seen at rest.
"""
