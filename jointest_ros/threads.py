"""One thread for numpy's matrix products, in the commands of this package."""

from __future__ import annotations

import os
import sys


def one_for_matrices() -> None:
    """Tell OpenBLAS to use one thread, unless the user chose a number or numpy is loaded already: then it is too late.

    The matrices of a filter are small. From some 50 rows on OpenBLAS would share them out among all cores, where they
    wait for each other up to fifty times as long as the product takes, and keep the cores from everybody else.
    """
    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
