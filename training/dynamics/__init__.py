"""What moves behind the steady state: delay, lags, network, and which of them leads an output.

`transport`, `lags`, `network` and `baselines` are fitted in this order, `mixture` weighs them on
held-out logs.
"""
