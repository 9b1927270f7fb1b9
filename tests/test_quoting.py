"""Any text typed as a prompt reaches the configuration unchanged."""

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from diffuphy.quoting import QUOTED, protect, quote, split

PROMPTS = [
    "a rubber burger, falling",
    "a dog's ball",
    'a "bouncy" ball',
    "it's a 'soft' \"toy\"",
    "a ball (red) = sphere: [a] {b}",
    "$5 coin, cost ${x} dollars, \\${x}, \\\\${x}",
    "a jelly; then sand & honey | rm -rf ~ `date` $(date)",
    "un gâteau qui tombe",
    "果冻汉堡掉落",
    "🍔 burger — “smart quotes”",
    "a ball #3! 50% jelly + 50% sand?",
    "1",
    "1e5",
    "true",
    "null",
    "",
    "a \\ b",
    "end\\",
    "back\\'q",
    "tab\there",
    "line\nbreak",
    " leading and trailing ",
    "choice(a,b)",
    "'tis the dogs' ball",
    "-m",
    "a=b",
]

NASTY = st.text(st.sampled_from("\\'\"${}x,=()[]#~ é果🍔\n"), max_size=12)
ANY = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=40)
"""A process argument cannot hold NUL; lone surrogates are not text."""


@pytest.fixture(scope="module")
def conf(tmp_path_factory):
    folder = tmp_path_factory.mktemp("conf")
    (folder / "train.yaml").write_text("prompt: ???\nx: 3\nrefine:\n  text: ${prompt}\n  negative: ''\n")
    with initialize_config_dir(str(folder), version_base="1.3"):
        yield


def read(argument: str, key: str = "prompt") -> str:
    """What the composed configuration holds."""
    return OmegaConf.select(compose("train", overrides=[argument]), key)


def parse(argument: str) -> str:
    """The same by the two readers alone, a hundred times as fast."""
    (override,) = OverridesParser.create().parse_overrides([argument])
    return OmegaConf.create({"prompt": override.value(), "x": 3}).prompt


@pytest.mark.parametrize("text", PROMPTS)
def test_prompt_survives(conf, text):
    """As itself, and where another key refers to it."""
    cfg = compose("train", overrides=protect([f"prompt={text}"]))
    assert cfg.prompt == text
    assert cfg.refine.text == text


@settings(max_examples=400, deadline=None)
@given(st.one_of(ANY, NASTY))
def test_any_text_survives(text):
    """read(quote(text)) == text; "???" alone is how the configuration says "missing", in quotes too."""
    if text == "???":
        return
    assert parse(f"prompt={quote(text)}") == text
    if not QUOTED.fullmatch(text):
        assert parse(*protect([f"prompt={text}"])) == text


@settings(max_examples=200, deadline=None)
@given(st.lists(st.one_of(ANY, NASTY), min_size=2, max_size=4))
def test_any_texts_survive_a_sweep(texts):
    """A sweep over quoted texts runs over exactly these texts."""
    texts = [t for t in texts if t != "???"]
    (argument,) = protect(["-m", "prompt=" + ",".join(map(quote, texts))])[1:]
    (override,) = OverridesParser.create().parse_overrides([argument])
    if len(texts) < 2:
        return
    assert [parse(f"prompt={element}") for element in override.sweep_string_iterator()] == texts


def test_quoted_prompt_keeps_its_meaning(conf):
    assert read(*protect(["prompt='already, quoted'"])) == "already, quoted"
    assert read(*protect(['prompt="already, quoted"'])) == "already, quoted"


@pytest.mark.parametrize(
    ("value", "texts"),
    [
        ("a ball,a dog", ["a ball", "a dog"]),
        ("a dog's ball,un gâteau,果冻", ["a dog's ball", "un gâteau", "果冻"]),
        ("1,true,1e5", ["1", "true", "1e5"]),
        ("'a ball, red',a dog", ["a ball, red", "a dog"]),
        ("choice(ball,dog)", ["ball", "dog"]),
        ("choice('a ball, red',dog)", ["a ball, red", "dog"]),
    ],
)
@pytest.mark.parametrize("flag", ["-m", "--multirun"])
def test_comma_separates_texts_in_a_sweep(conf, flag, value, texts):
    (argument,) = protect([flag, f"prompt={value}"])[1:]
    (override,) = OverridesParser.create().parse_overrides([argument])
    assert override.is_sweep_override()
    assert [read(f"prompt={element}") for element in override.sweep_string_iterator()] == texts


def test_one_text_in_a_sweep_is_no_sweep(conf):
    assert read(protect(["-m", "prompt=a dog's ball", "x=1,2"])[1]) == "a dog's ball"


def test_other_arguments_pass_unchanged():
    argv = [
        "-m",
        "seed=1,2",
        "experiment=tiny",
        "--cfg",
        "job",
        "fit.steps=10",
        "~x",
        "prompt",
        "+y={a:1}",
        "prompts=a,b",
    ]
    assert protect(argv) == argv


def test_text_below_a_group_is_protected(conf):
    assert read(*protect(["refine.negative=blur, noise"]), "refine.negative") == "blur, noise"
    assert protect(["+prompt=a, b"]) == ["+prompt='a, b'"]


def test_split_keeps_quoted_commas():
    assert split("'a, b', c ,") == ["'a, b'", "c", ""]
