"""Samples to a contact: no web, no files, no wall clock.

`surface` holds the newest sample and its contact. `follower` decides on the state that samples show, with the notes on
each; the notes on their sender come from `surface`.
"""
