"""What holds for every test: one BLAS thread a worker."""

import os

# Before numpy is imported, which reads them once. The workers divide the cores, so that more threads would only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
