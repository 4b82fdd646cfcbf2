"""Response times Ti and Tt: measured, judged by rules, and the loss of every choice for a speed."""
