"""Pictures of a model and how they change with every parameter, rendered once."""
