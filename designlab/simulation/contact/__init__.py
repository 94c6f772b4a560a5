"""How a press deforms the gel."""
