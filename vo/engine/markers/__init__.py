"""Markers as the map knows them: dictionaries, corners and their poses."""
