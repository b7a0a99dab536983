"""What estimators store of their centres."""

from typing import Any, cast

import numpy as np


class StoresCentersOnce:
    """Mixin for estimators with a parameter `centers` and fitted `centers_`.

    The latter are a copy, since the user may write to the former. A file holds one.
    """

    centers: Any

    def __getstate__(self) -> dict[str, Any]:
        state: dict[str, Any] = dict(cast(Any, super()).__getstate__())
        given, own = state["centers"], state.get("centers_")
        if own is not None and getattr(given, "dtype", None) == own.dtype:
            state["centers_"] = given if np.array_equal(given, own) else own
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        cast(Any, super()).__setstate__(state)
        if vars(self).get("centers_", self) is self.centers:
            self.centers_ = np.copy(self.centers)
