"""Types of the native module of radiance fields (`field/bind.cpp`)."""

from torch import Tensor

def encode_places(
    places: Tensor, table: Tensor, resolutions: Tensor, features: Tensor, num_threads: int = 1, instruction_set: str = ""
) -> None: ...
def grid_gradients(
    places: Tensor,
    table: Tensor,
    resolutions: Tensor,
    feature_gradients: Tensor,
    table_gradients: Tensor,
    place_gradients: Tensor,
    num_threads: int = 1,
    instruction_set: str = "",
) -> None: ...
