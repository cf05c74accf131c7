"""Other ways to the contacts than HTTP, one folder each."""
