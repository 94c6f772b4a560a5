"""From presses to scores with standard errors, and the weakest place of a design."""
