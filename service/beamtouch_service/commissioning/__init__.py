"""The commissioning of a surface: presses above each sensor and at marked places, and a verdict. No web, no clock.

`results` writes the confirmed ones to the record.
"""
