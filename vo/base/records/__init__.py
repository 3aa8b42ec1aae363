"""Records about a run that several wings exchange."""
