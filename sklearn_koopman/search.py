class KoopmanKernelRegressorCV:
    pass
