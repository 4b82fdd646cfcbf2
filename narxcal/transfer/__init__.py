"""Linear responses: first and second order, and state-space models with scheduling."""
