"""Small changes of a source that compiles: all of them, from which `mutate.py --draw` draws.

A change is a triple ``(start, end, new)``: ``text[start:end]`` becomes ``new``.  Each is one of

- an operator for another: + - * / and their assignments, comparisons, && ||;
- a constant: 0 for 1, true for false, and the reverse; a sign or a negation dropped;
- a term, a factor, a part of a condition or a side of a choice dropped;
- a condition negated, or one that never holds;
- a statement removed.
"""

import ast
import bisect
import io
import re
import tokenize

SWAPPED = {
    "+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"],
    "+=": ["-="], "-=": ["+="], "*=": ["/="], "/=": ["*="],
    "<": ["<=", ">"], "<=": ["<", ">="], ">": [">=", "<"], ">=": [">", "<="],
    "==": ["!="], "!=": ["=="], "&&": ["||"], "||": ["&&"], "and": ["or"], "or": ["and"],
    "0": ["1"], "1": ["0"], "0.0": ["1.0"], "1.0": ["0.0"],
    "true": ["false"], "false": ["true"], "True": ["False"], "False": ["True"],
}  # fmt: skip
RANK = {"*": 1, "/": 1, "%": 1, "+": 2, "-": 2, "<": 3, "<=": 3, ">": 3, ">=": 3, "==": 3, "!=": 3,
        "&&": 4, "||": 5, "?": 6, ":": 6, "=": 7, ",": 7, ";": 7, "return": 7}  # fmt: skip
SPACED = {"+", "-", "*", "/", "<", ">"}  # binary where there are spaces around
DROPPED = {"!": "!", "not": "not "}

_HIDDEN = re.compile(
    r"""/\*.*?\*/ | //[^\n]* | "(?:\\.|[^"\\])*" | '(?:\\.|[^'\\])*' | ^[ \t]*\#(?:\\\n|[^\n])*""",
    re.S | re.M | re.X,
)
_TOKEN = re.compile(
    r"->|<<=?|>>=?|\+\+|--|[<>=!]=|&&|\|\||[-+*/%&|^]=|0[xX][\w.]+(?:(?<=[pP])[+-]\w+)?"
    r"|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\w*|\w+|[^\s\w]"
)
_OPEN, _CLOSE = "([{", ")]}"
_DECLARED = re.compile(  # the start of a declaration, or a label
    r"(?:static|const|enum|struct|union|typedef|register|inline|extern|goto|case|default|_Static)\b"
    r"|(?:[A-Za-z_]\w*\s+\**|[A-Za-z_]\w*\s*\*+)(?!return)[A-Za-z_]\w*\s*(?:[;,=\[(]|$)"
)


def changes(name, text):
    """Return the changes of a file of C or, if its name says so, of Python."""
    return sorted(set(_python(text) if name.endswith(".py") else _c(text)))


def _one_token(text, token, start, end, before):
    """Yield the changes of one token; before is the one in front of it."""
    if token == "-" and not text[end : end + 1].isspace():
        if not re.match(r"[\w)\]]", before[-1:]) or before in ("return", "case"):
            yield start, end, ""
    elif token in DROPPED:
        yield start, start + len(DROPPED[token]), ""
    elif token not in SPACED or _apart(text, start, end):
        for new in SWAPPED.get(token, []):
            yield start, end, new


# ---- C -----------------------------------------------------------------------------------------


def _c(text):
    bare = _HIDDEN.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
    tokens = [(found[0], found.start(), found.end()) for found in _TOKEN.finditer(bare)]
    partner, open_ones, inside = {}, [], []
    for i, (token, _, _) in enumerate(tokens):
        inside.append(open_ones[-1] if open_ones else None)
        if token in _OPEN:
            open_ones.append(i)
        elif token in _CLOSE and open_ones:
            partner[open_ones[-1]] = i
            partner[i] = open_ones.pop()
    for i, (token, start, end) in enumerate(tokens):
        if inside[i] is None:  # outside of functions and tables
            continue
        yield from _one_token(text, token, start, end, tokens[i - 1][0])
        if RANK.get(token, 6) < 6 and _apart(bare, start, end) and RANK[token] != 3:
            yield from _parts(bare, tokens, partner, i)
        if token == "?":
            yield from _sides(bare, tokens, partner, i)
        if token in ("if", "while") and i + 1 in partner:
            first, last = tokens[i + 1][2], tokens[partner[i + 1]][1]
            yield first, last, f"!({text[first:last]})"
            if token == "if":
                yield first, last, "false"
    yield from _statements(bare, tokens, partner, inside)


def _apart(text, start, end):
    """Return whether a token has spaces around, as binary operators have."""
    return text[start - 1 : start].isspace() and text[end : end + 1].isspace()


def _end(bare, tokens, partner, i, rank, way):
    """Return the last token, from i on in a direction, of an operand of an operator of a rank."""
    while True:
        token, start, end = tokens[i + way]
        ends = RANK.get(token, 0) >= rank and (token not in SPACED or _apart(bare, start, end))
        if ends or token in (_CLOSE if way > 0 else _OPEN) or token in "{}":
            return i
        i = partner.get(i + way, i + way)


def _parts(bare, tokens, partner, i):
    """Yield what is left where the operand on either side of an operator is dropped."""
    left = _end(bare, tokens, partner, i, RANK[tokens[i][0]], -1)
    right = _end(bare, tokens, partner, i, RANK[tokens[i][0]], 1)
    yield tokens[left][1], tokens[i + 1][1], ""
    yield tokens[i - 1][2], tokens[right][2], ""


def _sides(bare, tokens, partner, i):
    """Yield a choice c ? a : b as a and as b."""
    left = _end(bare, tokens, partner, i, 7, -1)
    middle = _end(bare, tokens, partner, i, 6, 1)
    if tokens[middle + 1][0] == ":":
        last = _end(bare, tokens, partner, middle + 1, 7, 1)
        yield tokens[left][1], tokens[middle + 2][1], ""
        yield tokens[left][1], tokens[last][2], bare[tokens[i + 1][1] : tokens[middle][2]]


def _statements(bare, tokens, partner, inside):
    """Yield the removal of each statement that ends with a semicolon, but declarations."""
    begin = 0
    for i, (token, _, end) in enumerate(tokens):
        if token in "{}":
            begin = i + 1
        elif token == ";" and (inside[i] is None or tokens[inside[i]][0] != "("):
            heads, begin = [begin], i + 1
            while tokens[heads[-1]][0] in ("if", "for", "while", "else", "switch"):
                first = heads[-1] + 1
                heads.append(partner[first] + 1 if tokens[first][0] == "(" else first)
            for first in heads:
                start = tokens[first][1]
                if inside[i] is not None and first < i and tokens[first][0] != "else":
                    if not _DECLARED.match(bare[start:end]):
                        yield start, end, ";"


# ---- Python ------------------------------------------------------------------------------------


def _python(text):
    lines = [0]
    for line in text.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    before = ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.OP, tokenize.NAME, tokenize.NUMBER):
            start, end = (lines[row - 1] + column for row, column in (token.start, token.end))
            if not (token.string == "not" and text[end : end + 4] == " in "):
                yield from _one_token(text, token.string, start, end, before)
            before = token.string

    def span(node):  # columns of the syntax tree count bytes
        for row, column in (
            (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset),
        ):  # fmt: skip
            line = text[lines[row - 1] : lines[row]].encode()
            yield lines[row - 1] + len(line[:column].decode())

    removed = ast.Expr, ast.Assign, ast.AugAssign, ast.Return, ast.Raise, ast.Delete
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, removed) and not isinstance(
            getattr(node, "value", None), ast.Constant
        ):
            yield *span(node), "pass"
        elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
            start, end = span(node.test)
            yield start, end, f"not ({text[start:end]})"
            if not isinstance(node, ast.While):
                yield start, end, "False"
        elif isinstance(node, ast.BinOp):
            (start, left), (right, end) = span(node.left), span(node.right)
            yield start, right, ""
            yield left, end, ""
        elif isinstance(node, ast.BoolOp):
            spans = [tuple(span(value)) for value in node.values]
            for (start, end), (then, last) in zip(spans, spans[1:]):
                yield start, then, ""
                yield end, last, ""


def line_of(text, place):
    """Return the number of the line of a place."""
    return text.count("\n", 0, place) + 1
