"""The cut core of Incise in process: the same cut, to the bit, as `incise cut` and a server make.

    import incise
    body = incise.Body.phantom("liver", 60_000)
    cut = incise.cut(body, [(0, 0.03, -0.1, 0.07), (1, 0.03, 0.1, 0.07)], blade=((0, 0, 0), (0, 0, -0.12)))
    print(cut.report["pieces"], cut.report["state_hash"])
    cut.session.save("cut.vtu")

- ``Body``: a tetrahedral mesh, from arrays, a file or a phantom.
- ``Motion``: poses of a tool, or lines of a blade's edge, from arrays or a file.
- ``cut()``: what the command `incise cut` does, with its report.
- ``Session``: a body that is cut again and again, pose by pose or motion by motion, and deformed in between.
- ``Delta``: what a step has changed, as NumPy views.

Metres, seconds and newtons; one right-handed world frame. Errors are exceptions with the text that the command line prints: ``Error``
and, derived from it, ``MeshError``, ``ConfigError`` and ``MotionError``; ``TypeError`` and ``ValueError`` for arguments. A session
may be used by one thread at a time; others may cut theirs meanwhile, since the GIL is released.

Needs NumPy (Debian: python3-numpy), and the program incise-tetgen for surfaces and phantoms. From a build:
``PYTHONPATH=build/release/python /usr/bin/python3``.
"""

import pkgutil

# The extension module and the schema's tables are in the build tree, also where this file is found in the source tree first.
__path__ = pkgutil.extend_path(__path__, __name__)

try:
    from ._core import (Body, ConfigError, Cut, Delta, Error, MeshError, Motion, MotionError, Session, __version__, cut)
except ModuleNotFoundError as _error:
    # incise_client needs incise.wire alone, which is plain Python and may be there without the extension module.
    if _error.name != f"{__name__}._core":
        raise

    def __getattr__(name: str):
        raise AttributeError(f"module incise has no {name}: its extension module incise._core is not built for this Python "
                             "(./dev build makes it for Debian's 3.11: /usr/bin/python3)")

__all__ = ["Body", "ConfigError", "Cut", "Delta", "Error", "MeshError", "Motion", "MotionError", "Session", "cut"]
