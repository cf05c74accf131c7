"""The running daemon: a worker per surface, supervision, metrics, systemd."""
