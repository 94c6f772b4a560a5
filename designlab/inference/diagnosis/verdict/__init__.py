"""What a diagnosis concludes, and what to measure next."""
