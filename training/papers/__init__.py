"""Identification as the older papers do it: output error, responses, subspace, swarms.

`identify` is the way in, one function a method.
"""
