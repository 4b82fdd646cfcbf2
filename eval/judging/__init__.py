"""The verdict on a model: free runs over held-out logs, errors, response times, evidence.

`evaluate` judges one model, `compare` several, `crossval` one configuration on many divisions.
"""
