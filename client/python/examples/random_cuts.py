"""A hundred random cuts of one body, on all processors: random_cuts.py [CUTS]. The same seed gives the same bits anywhere."""
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import incise

body = incise.Body.phantom("cylinder", 2_000)
low, high = body.points.min(axis=0), body.points.max(axis=0)


def sample(seed):
    """A plane cut through a random point of the body, in a random direction."""
    random = np.random.default_rng(seed)
    through = random.uniform(low + 0.3 * (high - low), high - 0.3 * (high - low))
    along, across = np.linalg.qr(random.normal(size=(3, 2)))[0].T
    size = np.linalg.norm(high - low)
    heels = [through + size * (s * along - across) for s in (-1, 1)]
    lines = np.array([(heel, heel + 2 * size * across) for heel in heels])
    report = incise.cut(body, incise.Motion.lines(lines)).report  # other threads cut meanwhile: the GIL is released
    return report["pieces"], report["state_hash"]


with ThreadPoolExecutor() as pool:
    results = list(pool.map(sample, range(int(sys.argv[1]) if len(sys.argv) > 1 else 100)))
print(len(results), "cuts,", sum(pieces == 2 for pieces, _ in results), "leave two pieces,",
      len({state for _, state in results}), "states")
