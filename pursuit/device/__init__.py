"""Games on a GPU: the kernels of the CPU, each thread given one game as a batch of one.

calls       what a kernel is to be given, said without a GPU
checks      what is refused
kernels     the kernels of the CPU, compiled for the GPU by numba-cuda
waiting     what the next episodes begin with, settled on the CPU before it is known who needs it
simulator   the `Simulator` whose games lie on the GPU

Nothing here but `calls` is imported unless a GPU is asked for.
"""
