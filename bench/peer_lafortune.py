# SPDX-License-Identifier: MIT
"""peer_lafortune: Lafortune lobes of texels of a data-set folder by MINPACK's lmder through SciPy, for bench_lafortune.

peer_lafortune.py FOLDER LOBES TEXEL...

Prints for each texel the seconds of processor time, those of them that are MINPACK's own (not of the functions that make
residuals and Jacobian), and the relative error. All parameters are variables of the solver:
3 diffuse albedos, and 3 coefficients, the exponent and 3 albedos for each lobe; the Jacobian is analytic. One start.
"""
import json
import os
import sys
import time

os.environ["OPENBLAS_NUM_THREADS"] = "1"
import numpy as np
from scipy.optimize import least_squares

START = [(-1.0, -1.0, 1.0, 12.0), (0.3, 0.3, 1.0, 2.0), (1.0, 1.0, 1.0, 6.0), (-1.0, -1.0, 0.3, 4.0)]


def main():
    folder, lobes, texels = sys.argv[1], int(sys.argv[2]), [int(t) for t in sys.argv[3:]]
    with open(os.path.join(folder, "manifest.json")) as file:
        manifest = json.load(file)
    views, lights = np.array(manifest["views"]), np.array(manifest["lights"])
    width, height, channels = manifest["width"], manifest["height"], len(manifest["channels"])
    kind = {"f16": np.float16, "f32": np.float32}[manifest["type"]]
    pairs = len(views) * len(lights)
    product = (views[:, None, :] * lights[None, :, :]).reshape(pairs, 3)
    cosine = np.tile(lights[:, 2], len(views)) if manifest["quantity"] == "brdf_cos" else np.ones(pairs)
    samples = np.memmap(os.path.join(folder, "samples.bin"), kind, "r")
    if manifest["order"] == "vlyxc":
        samples = samples.reshape(pairs, height * width, channels)
    else:
        samples = samples.reshape(height * width, pairs, channels).transpose(1, 0, 2)

    def parts(x):
        result = []
        for j in range(lobes):
            p = x[channels + j * (4 + channels):]
            base = product @ p[:3]
            alive = base > 0
            log = np.log(np.where(alive, base, 1.0))
            with np.errstate(over="ignore"):
                value = np.where(alive, np.exp(p[3] * log), 0.0) * cosine
            result.append((base, alive, log, value, p[3], p[4:4 + channels]))
        return result

    inside = [0.0]

    def timed(function):
        def call(x):
            start = time.process_time()
            result = function(x)
            inside[0] += time.process_time() - start
            return result
        return call

    def residuals(x):
        model = cosine[:, None] * x[:channels][None, :]
        for _, _, _, value, _, albedo in parts(x):
            model = model + value[:, None] * albedo[None, :]
        return (model - data).ravel()

    def jacobian(x):
        j = np.zeros((pairs, channels, len(x)))
        for c in range(channels):
            j[:, c, c] = cosine
        for i, (base, alive, log, value, n, albedo) in enumerate(parts(x)):
            at = channels + i * (4 + channels)
            by_base = np.where(alive, n * value / np.where(alive, base, 1.0), 0.0)
            for c in range(channels):
                j[:, c, at:at + 3] = albedo[c] * by_base[:, None] * product
                j[:, c, at + 3] = albedo[c] * value * log
                j[:, c, at + 4 + c] = value
        return j.reshape(pairs * channels, -1)

    for texel in texels:
        data = np.array(samples[:, texel, :], np.float64)
        mean = data.mean(axis=0)
        x = np.concatenate([0.7 * mean] + [np.concatenate([START[j], 0.3 * mean]) for j in range(lobes)])
        inside[0] = 0.0
        start = time.process_time()
        fit = least_squares(timed(residuals), x, jac=timed(jacobian), method="lm", ftol=1e-6, xtol=1e-6, gtol=1e-10, max_nfev=400)
        seconds = time.process_time() - start
        print(seconds, seconds - inside[0], np.sqrt(2.0 * fit.cost / max(float((data ** 2).sum()), 1e-300)), flush=True)


main()
