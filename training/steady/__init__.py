"""Steady states fitted to logs.

`steady_choice` chooses the layout and leaves out what contradicts, `steady_fit` fits curves of
engines, `static_fit` the static laws of the papers.
"""
