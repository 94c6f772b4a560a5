"""How probable frames are under a state of the model."""
