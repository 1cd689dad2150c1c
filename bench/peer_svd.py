# SPDX-License-Identifier: MIT
"""peer_svd: scikit-learn's randomized SVD on the samples of a data-set folder, for bench_svd.

peer_svd.py SAMPLES IMAGES TEXELS CHANNELS RANK ITERATIONS NORMALISER

The matrix has a row per image and channel and a column per texel. It is converted to float32 before the clock starts;
the conversion is reported on its own. The error is that of the differences, added up in double after the clock has stopped.
"""
import sys
import time

import numpy as np
from sklearn.utils.extmath import randomized_svd
from threadpoolctl import threadpool_info


def main():
    path, images, texels, channels, rank, iterations, normaliser = sys.argv[1:8]
    images, texels, channels, rank, iterations = (int(v) for v in (images, texels, channels, rank, iterations))

    start = time.perf_counter()
    samples = np.memmap(path, np.float16, "r", shape=(images, texels, channels))
    matrix = np.empty((images, channels, texels), np.float32)
    for image in range(images):
        matrix[image] = samples[image].T
    matrix = matrix.reshape(images * channels, texels)
    conversion = time.perf_counter() - start

    start, processor = time.perf_counter(), time.process_time()
    left, sigma, right = randomized_svd(
        matrix, n_components=rank, n_iter=iterations, power_iteration_normalizer=normaliser, random_state=1
    )
    seconds, processor = time.perf_counter() - start, time.process_time() - processor

    energy = rest = 0.0
    for block, rows in zip(np.array_split(matrix, 64), np.array_split(left * sigma, 64)):
        energy += sum(float(np.sum(np.square(row, dtype=np.float64))) for row in block)
        rest += sum(float(np.sum(np.square(row, dtype=np.float64))) for row in block - rows @ right)
    error = np.sqrt(rest / energy)
    kernel = next((i["architecture"] for i in threadpool_info() if i["internal_api"] == "openblas"), "unknown")
    print(f"seconds {seconds:.4f} processor {processor:.4f} error {error:.8f} conversion {conversion:.4f} kernel {kernel}")


main()
