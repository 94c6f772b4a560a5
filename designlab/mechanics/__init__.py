"""Elastic layers and contact: arrays in, arrays out."""
