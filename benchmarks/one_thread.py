"""Imported before numpy, which reads the number of threads when it is loaded: a step wants one."""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"
