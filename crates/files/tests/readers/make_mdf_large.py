"""asammdf writes two files of a million rows of 15 channels, 128 MB plain and compressed. argv: folder"""
import sys

import numpy as np
from asammdf import MDF, Signal

folder = sys.argv[1]
rows = np.arange(1_000_000)
time = rows * 1e-3
signals = [Signal((rows % (k + 7)).astype(float), time, name=f"c{k}", unit="Nm") for k in range(15)]
for compression in (0, 2):
    mdf = MDF(version="4.10")
    mdf.append(signals)
    mdf.save(f"{folder}/large_{compression}.mf4", compression=compression, overwrite=True)
    mdf.close()
print("asammdf wrote two files of 1 000 000 rows")
