"""Modules of the grasp benchmark. Each process of the benchmark uses one core."""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
