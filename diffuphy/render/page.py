"""Skeleton and style of the report: one column of sections, light and dark, wide screens and narrow ones, and paper."""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<header><p>{heading}</p><h1>{title}</h1></header>
<main>
{body}
</main>
</body>
</html>
"""  # noqa: E501

STYLE = """
:root {
  --paper: #fbfaf7; --card: #ffffff; --ink: #1d1c1a; --soft: #66625a; --line: #e4e0d8; --accent: #b4531f;
  --warn: #fff4e0; --warn-line: #e0a030;
  --s0: #4477aa; --s1: #ee8866; --s2: #228833; --s3: #ccbb44; --s4: #66ccee; --s5: #aa3377; --s6: #999999;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #151413; --card: #1e1d1b; --ink: #ece9e3; --soft: #a39d92; --line: #35322e; --accent: #f09a62;
    --warn: #2e2412; --warn-line: #b57f22;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0 auto; padding: 2.5rem clamp(1rem, 4vw, 3rem) 4rem; max-width: 72rem;
  background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, "Segoe UI", "DejaVu Sans", sans-serif;
}
header p { margin: 0; color: var(--accent); font-size: .8rem; font-weight: 600; letter-spacing: .12em; text-transform: uppercase; }
h1 { margin: .1em 0 .8em; font-size: clamp(1.7rem, 4.5vw, 2.7rem); line-height: 1.15; letter-spacing: -.015em; text-wrap: balance; }
h2 { margin: 0 0 1rem; font-size: 1.15rem; letter-spacing: -.005em; }
section { margin-top: 2.75rem; padding-top: 1.5rem; border-top: 1px solid var(--line); }
img, video { display: block; max-width: 100%; height: auto; }
figure { margin: 0; }
figcaption { margin-top: .45rem; color: var(--soft); font-size: .82rem; line-height: 1.4; overflow-wrap: anywhere; }

.hero { display: flex; flex-wrap: wrap; gap: 1.75rem; align-items: flex-start; }
.film { flex: 3 1 22rem; max-width: 36rem; }
.film video, .film img { width: 100%; border-radius: .6rem; background: var(--line); }
.numbers { flex: 2 1 16rem; margin: 0; display: grid; grid-template-columns: repeat(auto-fit, minmax(12rem, 1fr)); gap: .8rem; }
.numbers div { padding: .85rem 1rem; background: var(--card); border: 1px solid var(--line); border-radius: .6rem; }
.numbers dt { color: var(--soft); font-size: .8rem; overflow-wrap: anywhere; }
.numbers dd { margin: .1rem 0 0; font-size: 1.45rem; font-weight: 600; font-variant-numeric: tabular-nums; line-height: 1.3; }
.numbers dd.note { color: var(--soft); font-size: .78rem; font-weight: 400; line-height: 1.4; }
.numbers + .plots { margin-top: 1rem; }
sup { font-size: .65em; line-height: 0; }

.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(11rem, 100%), 1fr)); gap: 1rem; }
.tiles.large { grid-template-columns: repeat(auto-fill, minmax(min(17rem, 100%), 1fr)); }
.tiles img, .wide img { width: 100%; border: 1px solid var(--line); border-radius: .5rem; background: #fff; }
.wide figcaption { display: none; }

.plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(20rem, 100%), 1fr)); gap: 1rem; }
.plots figure { padding: .7rem; background: var(--card); border: 1px solid var(--line); border-radius: .6rem; }
svg { display: block; width: 100%; height: auto; font: 11px system-ui, "DejaVu Sans", sans-serif; }
svg text { fill: var(--soft); }
svg .name { fill: var(--ink); font-size: 13px; font-weight: 600; }
svg .value { fill: var(--accent); font-size: 13px; font-weight: 600; }
svg .grid { stroke: var(--line); stroke-width: 1; }
svg .curve { fill: none; stroke: var(--accent); stroke-width: 1.8; stroke-linejoin: round; }
svg .dot { fill: var(--accent); }
svg .band { fill: var(--accent); opacity: .16; }
.says { max-width: 46rem; margin: 1rem 0 0; }

.scroll { overflow-x: auto; }
table { width: 100%; border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th { padding: .3rem .9rem .45rem 0; color: var(--soft); font-size: .78rem; font-weight: 600; text-align: left; white-space: nowrap; }
td { padding: .45rem .9rem .45rem 0; border-top: 1px solid var(--line); vertical-align: top; }
td.num, th.num { text-align: right; white-space: nowrap; }
td:last-child, th:last-child { padding-right: 0; }
tfoot td { border-top: 2px solid var(--line); font-weight: 600; }
.plan td:first-child, .stages td:first-child { font-weight: 600; white-space: nowrap; }
.plan td:last-child { color: var(--soft); min-width: 16rem; }
.bar { display: flex; gap: 2px; height: .7rem; margin-bottom: 1rem; border-radius: .35rem; overflow: hidden; }
.bar span { flex-basis: 0; min-width: 0; }
.key { display: inline-block; width: .7em; height: .7em; margin-right: .5em; border-radius: .2em; }
.s0 { background: var(--s0); } .s1 { background: var(--s1); } .s2 { background: var(--s2); }
.s3 { background: var(--s3); } .s4 { background: var(--s4); } .s5 { background: var(--s5); } .s6 { background: var(--s6); }

aside { margin-bottom: 1.75rem; padding: .8rem 1.1rem; background: var(--warn); border-left: 4px solid var(--warn-line); border-radius: .4rem; }
aside ul { margin: .2rem 0 0; padding-left: 1.1rem; }
summary { cursor: pointer; color: var(--soft); font-size: .9rem; }
pre {
  margin: .8rem 0 0; padding: 1rem; overflow-x: auto; background: var(--card); border: 1px solid var(--line); border-radius: .6rem;
  font: .8rem/1.5 ui-monospace, "DejaVu Sans Mono", monospace;
}
@media print { body { max-width: none; padding: 0; } section { break-inside: avoid; } video { display: none; } }
"""  # noqa: E501
