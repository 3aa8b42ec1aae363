"""Command line: parse arguments, load settings, call one library function, print a table."""
