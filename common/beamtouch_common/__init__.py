"""The ground floor: what all packages share. It imports none of them, and needs pydantic at most."""
