"""Our own figures, each measured when asked for; `eval.bench` prints them."""
