"""The running daemon: acquisition and delivery of each surface, supervision, metrics, systemd."""
