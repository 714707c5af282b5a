"""Search the parameters of STDP; see `snnrl.thesis.search`."""

import torch

from snnrl.thesis.search import main

if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
