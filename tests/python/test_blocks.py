"""The checker of pages (tests/check_blocks.py) finds code that does not do what its page says."""

import subprocess
import sys
from pathlib import Path

import pytest

CHECKER = Path(__file__).parents[1] / "check_blocks.py"

GOOD = {
    "numbers": "```python\nprint(1.234, 'a', 3e-16)\n```\n\n```text\n1.23 a 1e-16\n```\n",
    "one script": "```python\nx = 2\n```\n\n```python\nprint(x)\n```\n\n```text\n2\n```\n",
    "dots": "```python\nprint('a b\\nc\\nd')\n```\n\n```text\na ...\n...\nd\n```\n",
    "error": "```python\n1/0\n```\n\n```text\nTraceback (most recent call last):\n"
    "ZeroDivisionError: division by zero\n```\n",
    "file": "```python own.py\nprint('here')\n```\n\n```console\n$ python own.py\nhere\n```\n",
    "status": "```console\n$ false  # exits with 1\n$ echo \\\n    x\nx\n```\n",
    "pickle": "```python\nimport pickle\ndef f(): pass\nprint(pickle.loads(pickle.dumps(f)) is f)\n"
    "```\n\n```text\nTrue\n```\n",
    "in a tab": ":::{tab-item} x\n```{code-block} python\nprint(1)\n```\n\n```text\n1\n```\n:::\n",
    "commands": "```console\n$ python -c 'print(1)'\n1\n$ dalembert --version\n"
    "dalembert ...\n```\n",
    "not run": "```sh\nfalse\n```\n\n```none\nx\n```\n",
}
BAD = {
    "number": ("```python\nprint(1.234)\n```\n\n```text\n1.29\n```\n", "line 6: the page says"),
    "whole number": ("```python\nprint(1000)\n```\n\n```text\n1001\n```\n", "1001"),
    "word": ("```python\nprint('a')\n```\n\n```text\nb\n```\n", "the page says"),
    "more": ("```python\nprint('a b')\n```\n\n```text\na\n```\n", "the page says"),
    "line": ("```python\nprint('a\\nb')\n```\n\n```text\na\n```\n", "the page says"),
    "nothing": ("```python\nx = 1\n```\n\n```text\na\n```\n", "the page says"),
    "raised": ("\n```python\n\n1/0\n```\n", 't.md:3>", line 4'),
    "other error": (GOOD["error"].replace("division by", "other"), "the page says"),
    "command": ("```console\n$ true\n$ false\n```\n", "false: exit status 1"),
    "no failure": ("```console\n$ true  # exits with 1\n```\n", "exit status 0"),
    "output": ("```console\n$ echo a\nb\n```\n", "the page says"),
    "no command": ("```console\na\n```\n", "before the first command"),
    "program": ("```c\nint main(void) { return 3; }\n```\n", "exit status 3"),
    "compiler": ("```c\nint main(void) { return x; }\n```\n", "undeclared"),
}


def check(tmp_path, text):
    page = tmp_path / "t.md"
    page.write_text(text)
    command = [sys.executable, CHECKER, page]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", GOOD)
def test_a_page_that_is_right(tmp_path, name):
    done = check(tmp_path, GOOD[name])
    assert done.returncode == 0, done.stderr
    assert ": 0 blocks" not in done.stdout or name == "not run"


@pytest.mark.parametrize("name", BAD)
def test_a_page_that_is_wrong(tmp_path, name):
    text, words = BAD[name]
    done = check(tmp_path, text)
    assert done.returncode == 1 and words in done.stderr, done
