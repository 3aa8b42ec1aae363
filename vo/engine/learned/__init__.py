"""Learned features: model files, their making and checking, and inference."""
