# SPDX-License-Identifier: MIT
"""peer_lpca: scikit-learn's k-means and a PCA of each cluster on the samples of a data-set folder, for bench_lpca.

peer_lpca.py SAMPLES IMAGES TEXELS CHANNELS USED CLUSTERS COMPONENTS

Takes the first USED of the TEXELS of each image, a row for each texel. Conversion to float32 is before the clock starts.
"""
import sys
import time

import numpy as np
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA


def main():
    images, texels, channels, used, clusters, components = (int(v) for v in sys.argv[2:8])
    samples = np.memmap(sys.argv[1], np.float16, "r", shape=(images, texels, channels))
    matrix = np.empty((used, images, channels), np.float32)
    for image in range(images):
        matrix[:, image] = samples[image, :used]
    matrix = matrix.reshape(used, images * channels)

    start, processor = time.perf_counter(), time.process_time()
    labels = KMeans(clusters, n_init=1, random_state=1).fit_predict(matrix)
    squared = 0.0
    for k in range(clusters):
        members = matrix[labels == k]
        count = min(components, *members.shape)
        pca = PCA(count, svd_solver="randomized", random_state=1).fit(members)
        left = members - pca.inverse_transform(pca.transform(members))
        squared += float(np.einsum("ij,ij->", left, left, dtype=np.float64))
    seconds, processor = time.perf_counter() - start, time.process_time() - processor
    energy = float(np.einsum("ij,ij->", matrix, matrix, dtype=np.float64))
    print(f"seconds {seconds:.4f} processor {processor:.4f} error {np.sqrt(squared / energy):.8f}")


main()
