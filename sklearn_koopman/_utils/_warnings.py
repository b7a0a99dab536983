"""Warnings that point at the line of the user's code that led to them."""

import sys
import warnings
from types import FrameType

PACKAGE = __package__.partition(".")[0]


class ExtrapolationWarning(UserWarning):
    """Warning about predictions at states that are far from all training data.

    They say nothing about the motion there. Their states are often in another unit
    than those of the training data, or have not passed the scaler that those have.

    See Also
    --------
    sklearn_koopman.KoopmanKernelRegressor.power_function : Tells states apart that are
        near the training data and states that are far.

    Examples
    --------
    Make it an error:

    >>> import warnings
    >>> from sklearn_koopman import ExtrapolationWarning, KoopmanKernelRegressor
    >>> model = KoopmanKernelRegressor().fit([[0.0], [1.0], [2.0]], [0.0, 1.0, 4.0])
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", ExtrapolationWarning)
    ...     model.predict([[200.0]])
    Traceback (most recent call last):
        ...
    sklearn_koopman.ExtrapolationWarning: All states of X are so far ...
    """

    __module__ = PACKAGE


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that called this package."""
    frame: FrameType | None = sys._getframe()
    level = 0
    while frame is not None and frame.f_globals["__name__"].startswith(PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level + 1)
