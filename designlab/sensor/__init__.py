"""What a sensor is: design, rules, camera, lens, LED catalogue, materials and presets."""
