"""`python -m vo`: the command line, as the program `vo`."""

from vo.cli.entry import main

if __name__ == "__main__":
    main()
