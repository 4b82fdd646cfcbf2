"""`Narx`, a scikit-learn estimator for records of any system, and the ladder of forms it climbs."""
