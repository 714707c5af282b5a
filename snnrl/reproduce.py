"""The whole thesis from one command; see `snnrl.thesis.reproduce`."""

from snnrl.thesis.reproduce import main

if __name__ == "__main__":
    main()
