"""A calibration of the dynamics, its state between samples, its bundle, and the Kalman fuser."""
