import torch

torch.set_num_threads(1)  # on a busy machine, threads that share small tensors mostly wait
