"""The command line: parse, load the config, call one library function, print a table."""
