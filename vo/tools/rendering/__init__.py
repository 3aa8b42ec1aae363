"""Virtual content: models drawn into the images of a recording with the poses of a run."""
