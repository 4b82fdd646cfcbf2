"""The virtual flight test: what pilot, day and sensors do, as arrays.

The engine itself is `narxcal.turbofan`; files are written by `eval`.
"""
