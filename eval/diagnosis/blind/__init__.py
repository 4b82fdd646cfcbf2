"""Cases whose effect is withheld: made, answered without the key, and scored with it."""
