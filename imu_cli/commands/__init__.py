"""One verb per file: module ``verb.py`` holds a function ``verb`` that Typer turns into a command.

The first line of the module's docstring is the line that ``imu-cal --help`` shows. A trailing
underscore (``import_.py``) keeps a verb from being a Python keyword.
"""
