"""The whole thesis from one command; see `snnrl.thesis.reproduce`."""

from snnrl.extras import demand

demand("snnrl.reproduce", "thesis")

from snnrl.thesis.reproduce import main  # noqa: E402

if __name__ == "__main__":
    main()
