"""Faults that logs show by each other, before anything is learned from them.

`redundancy_fit` learns a bank of channels that say the same, `screen` judges a `subject` by it,
`stretches` finds parts that are at fault, `masking` says what may be learned; `scatter` and
`levels` are what sound recordings differ by.
"""
