"""Making of the files of learned models from the weights of their authors."""
