"""Makes the blocks of the font of figures from Inter, of the Debian package fonts-inter 4.0~beta7+ds-1.

Run `pip install fonttools==4.68.0` and `dpkg -x fonts-inter_*.deb /tmp/inter`, then
`python3 src/report/fonts/subset.py /tmp/inter/usr/share/fonts/opentype/inter`.

A figure embeds the blocks whose letters it has. The first block, `Inter-Regular.otf` and
`Inter-SemiBold.otf`, has the letters of every figure and is not made again, so that figures keep
their bytes; the other blocks have what it lacks. Each letter has its LaTeX in `src/report/letters.rs`.
"""

import sys
from pathlib import Path

from fontTools import subset
from fontTools.ttLib import TTFont

HERE = Path(__file__).parent


def letters(*ranges):
    return {code for first, last in ranges for code in range(first, last + 1)}


BLOCKS = {
    # Latin-1 and Latin Extended-A without `ĸ` and `ſ`, Romanian, the German ẞ, and signs.
    "Latin": letters((0xA1, 0x137), (0x139, 0x17E), (0x218, 0x21B), (0x1E9E, 0x1E9E))
    | set(map(ord, "‐‑‚„†‡•′″‹›⁄⁰⁴⁵⁶⁷⁸⁹⁺⁻ⁿ₀₁₂₃₄₅₆₇₈₉₊₋€℃№™↔⇒⇔∂∆∏∑√∞≠■□▲△▼▽◆◇○▶◀")),
    "Vietnamese": letters((0x1A0, 0x1A1), (0x1AF, 0x1B0), (0x1EA0, 0x1EF9)),
    "Greek": letters((0x386, 0x386), (0x388, 0x3CE)) | set(map(ord, "ϑϕϵϱϖ")),
    # What the encoding T2A of LaTeX has.
    "Cyrillic": letters((0x400, 0x45F))
    | set(map(ord, "ҐґҒғҖҗҘҙҚқҜҝҠҡҢңҤҥҪҫҮүҰұҲҳҶҷҸҹҺһӀӁӂӐӑӒӓӔӕӖӗӘәӚӛӜӝӞӟӢӣӤӥӦӧӨөӬӭӮӯӰӱӲӳӴӵӸӹ")),
}


def main(folder):
    for weight in ("Regular", "SemiBold"):
        first = set(TTFont(HERE / f"Inter-{weight}.otf").getBestCmap())
        for block, codes in BLOCKS.items():
            font = TTFont(folder / f"Inter-{weight}.otf", recalcTimestamp=False)
            has = set(font.getBestCmap())
            options = subset.Options()
            options.layout_features = []
            options.hinting = False
            options.desubroutinize = True
            options.notdef_outline = True
            options.name_IDs = ["*"]
            options.drop_tables += ["GDEF", "GPOS", "GSUB"]
            subsetter = subset.Subsetter(options)
            subsetter.populate(unicodes=(codes & has) - first)
            subsetter.subset(font)
            font.save(HERE / f"Inter-{weight}-{block}.otf")
            lacks = "".join(map(chr, sorted(codes - has)))
            print(f"{weight} {block}: {len((codes & has) - first)} letters, lacks {lacks!r}")


main(Path(sys.argv[1]))
