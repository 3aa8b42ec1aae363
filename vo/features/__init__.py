"""The feature laboratory: detectors, descriptors and matchers by name, for `vo run` and alone."""
