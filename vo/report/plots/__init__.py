"""The figures of a report; each module draws what belongs together."""
