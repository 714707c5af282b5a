"""`python -m snnrl.beyond`."""

import torch

from snnrl.beyond.command import main

if __name__ == "__main__":
    with torch.no_grad():
        main()
