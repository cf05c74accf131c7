"""What each command of `design-sensors` does, a module each with a function `run`: read, call the pure parts, write."""
