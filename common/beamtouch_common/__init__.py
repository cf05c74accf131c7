"""The ground floor: code that all packages share. It imports none of them, and needs pydantic at most."""
