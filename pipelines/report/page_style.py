"""The style sheet of the report page: readable by day and by night, on wide and narrow screens."""

STYLE_SHEET = """
:root { color-scheme: light dark; --ink: #1a1a1a; --faint: #595959; --paper: #fbfbfa;
  --card: #ffffff; --line: #d5d5d2; --good: #00694c; --good-back: #dff3ec; --bad: #8f3400;
  --bad-back: #fce6da; --unknown: #574a00; --unknown-back: #f8f0c9; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e6; --faint: #a9a9a5; --paper: #161718; --card: #1f2123; --line: #3b3d40;
    --good: #7fe0bf; --good-back: #0d3b2d; --bad: #ffb48f; --bad-back: #4a2110;
    --unknown: #f0dd86; --unknown-back: #3d3608; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem 1.2rem 4rem; max-width: 82rem; background: var(--paper);
  color: var(--ink); font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif;
  overflow-wrap: anywhere; }
.verdict { margin: 0 0 1.4rem; padding: .8rem 1rem; border-left: .4rem solid; border-radius: .3rem;
  font-size: 1.15rem; font-weight: 600; }
.good { color: var(--good); background: var(--good-back); }
.bad { color: var(--bad); background: var(--bad-back); }
.unknown { color: var(--unknown); background: var(--unknown-back); }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 .2rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .5rem; }
h3 { font-size: 1.05rem; margin: 1.6rem 0 .4rem; }
p, ul { max-width: 50rem; }
.faint { color: var(--faint); }
figure { margin: .6rem 0 0; }
/* The figures have a white ground of their own, so that they read the same by night. */
.sheet { overflow-x: auto; background: #fff; border: 1px solid var(--line); border-radius: .4rem; }
.sheet img { display: block; width: 100%; min-width: 56rem; height: auto; }
figcaption { margin-top: .5rem; max-width: 60rem; color: var(--faint); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: .4rem 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .28rem 1.1rem .28rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; font-weight: 400; }
th[scope=row] { overflow-wrap: break-word; min-width: 7rem; }
thead th { color: var(--faint); border-bottom-width: 2px; }
td.number, th.number { text-align: right; white-space: nowrap; }
.columns { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr));
  gap: 0 2.5rem; align-items: start; }
details { margin: .6rem 0; } summary { cursor: pointer; font-weight: 600; }
a { color: inherit; }
@media print { .sheet { overflow: visible; } .sheet img { min-width: 0; } }
"""
