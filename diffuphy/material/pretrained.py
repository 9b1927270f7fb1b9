"""Weights of an encoder that was trained on other objects before (``benchmarks/pretrain.py``)."""

from pathlib import Path

from diffuphy.material.encoder import Encoder


def load(encoder: Encoder, file: Path) -> None:
    """Give an encoder the weights of a file of safetensors, all of them and no others; its dtype and device stay.

    Raises:
        ValueError: the file is broken, or holds other names or shapes than the encoder has.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        state = load_file(file)
    except SafetensorError as broken:
        raise ValueError(f"net.pretrained = {file} is not a file of safetensors ({broken}); make it again") from None
    have = {name: tuple(value.shape) for name, value in encoder.state_dict().items()}
    got = {name: tuple(value.shape) for name, value in state.items()}
    wrong = [n for n in sorted(have.keys() | got.keys()) if have.get(n) != got.get(n)]
    if wrong:
        n = wrong[0]
        raise ValueError(
            f"net.pretrained = {file} does not fit: {n} is {got.get(n, 'missing')} in the file and "
            f"{have.get(n, 'missing')} in the encoder ({len(wrong)} of {len(have)} differ); "
            "use net.width and net.depth of the file, or net.pretrained=null"
        )
    encoder.load_state_dict(state)
