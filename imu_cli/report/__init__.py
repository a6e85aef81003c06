"""Reports: what a document says, as one page, one picture, or one certificate.

`contents` turns a calibration, a diagnosis or a recording into a `Report`: a verdict, tables and
charts, with no word about how they are drawn. `page` draws it with Plotly into one HTML file,
`picture` with Matplotlib into PNG or SVG.
"""
