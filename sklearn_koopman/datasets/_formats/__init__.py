"""The formats of files, each in a module of its own, and their registry."""

from ._c3d import C3D
from ._deeplabcut import DEEPLABCUT
from ._foreign import describe
from ._qualisys import QUALISYS
from ._recording import Recording
from ._tabbed import TABBED
from ._text import File
from ._trc import TRC
from ._vicon import VICON
from ._visual3d import VISUAL3D

# A file is read by the first that recognises it.
FORMATS = (C3D, TRC, QUALISYS, VICON, DEEPLABCUT, VISUAL3D, TABBED)


def read_recording(file: File) -> Recording:
    """Read the markers of a file of any of the formats."""
    for form in FORMATS:
        if form.recognize(file):
            return form.read(file)
    known = ", ".join(form.name for form in FORMATS)
    raise ValueError(f"{describe(file)}\nFormats of markers: {known}.")
