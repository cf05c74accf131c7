"""The process: sockets, uvicorn, systemd, and watching the model files."""
