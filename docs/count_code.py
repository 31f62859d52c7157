"""Figures of the program's code, as docs/architecture.md has them: files, lines, names, imports, parameters, options.

python docs/count_code.py
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FILES = {
    ".".join(path.relative_to(base).with_suffix("").parts).removesuffix(".__init__"): path
    for base in (ROOT, ROOT / "plugins")
    for path in sorted(base.glob("geomosaic*/**/*.py"))
}
Function = ast.FunctionDef | ast.AsyncFunctionDef
# By a pattern, as syntax trees of all files take seconds: decorators, name, parameters and docstring of a function.
FUNCTION = re.compile(
    r'^((?:@[^@]*?\n)*)def ([a-z]\w*)\((.*?)\)(?: -> [^\n]*)?:[^\n]*\n(?:    r?"""(.*?)""")?', re.DOTALL | re.MULTILINE
)


@cache
def tree(name: str) -> ast.Module:
    """Syntax tree of a module."""
    return ast.parse(FILES[name].read_text())


def documentable(text: str) -> Iterator[tuple[str, str, str]]:
    """Name, parameters and docstring of each public function of a file that takes parameters.

    Commands of click are left out, whose docstring is their help, and so are its callbacks.
    """
    for decorators, name, given, documentation in FUNCTION.findall(text):
        if given.strip() and not given.startswith("ctx:") and not re.search(r"command\(|@overload", decorators):
            yield name, given, documentation


def undocumented(text: str) -> list[str]:
    """Public functions of a file whose docstring does not list all of their parameters."""
    found = []
    for name, given, documentation in documentable(text):
        listed = documentation.partition("Parameters\n    ------")[2]
        names = set(re.findall(r"\w+", " ".join(re.findall(r"^    (\S.*?)(?: : .*)?$", listed, re.MULTILINE))))
        arguments = ast.parse(f"def f({given}): ...").body[0].args
        if not all(one.arg in names for one in ast.iter_child_nodes(arguments) if isinstance(one, ast.arg)):
            found.append(name)
    return found


def kinds_of_lines(text: str) -> tuple[int, int, int]:
    """Lines that hold code other than docstrings, lines of docstrings, and lines that hold comments."""
    docs = {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Module | ast.ClassDef | Function) and ast.get_docstring(node) is not None
        for line in range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1)
    }
    code, comments = set[int](), set[int]()
    blank = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING, tokenize.ENDMARKER}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments.add(token.start[0])
        elif token.type not in blank:
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - docs), len(docs), len(comments)


def imports(name: str) -> Iterator[str]:
    """Modules of the program that a module imports, inside functions too."""
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in FILES)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield from (known for known in (full if full in FILES else node.module,) if known in FILES)


@cache
def depth(name: str) -> int:
    """Modules in the longest chain of imports that starts at a module."""
    return 1 + max((depth(other) for other in imports(name) if other != name), default=0)


def parameters(function: Function) -> int:
    """Number of parameters of a function."""
    given = function.args
    own = [each for each in (*given.posonlyargs, *given.args, *given.kwonlyargs) if each.arg not in ("self", "cls")]
    return len(own) + (given.vararg is not None) + (given.kwarg is not None)


def main() -> None:
    """Print the figures."""
    texts = {name: path.read_text() for name, path in FILES.items()}
    heads = [name for name, path in FILES.items() if path.name == "__init__.py" and len(texts[name].splitlines()) < 3]
    lines = {name: len(text.splitlines()) for name, text in texts.items()}
    counted = [kinds_of_lines(text) for text in texts.values()]
    every = [
        (parameters(node), f"{name}.{node.name}")
        for name in FILES
        for node in ast.walk(tree(name))
        if isinstance(node, Function)
    ]
    outside = [one for one in every if not one[1].startswith("geomosaic.kernels.")]
    classes = sum(isinstance(node, ast.ClassDef) for name in FILES for node in ast.walk(tree(name)))
    functions = [name for text in texts.values() for name, *_ in documentable(text)]
    without = [f"{name}.{each}" for name, text in texts.items() for each in undocumented(text)]
    of_options = [text for name, text in texts.items() if name.startswith("geomosaic.options.")]
    options = sum(len(re.findall(r" = option\(", text)) for text in of_options)
    flags = sum(text.count("click.option(") for name, text in texts.items() if ".cli.commands." in name)
    public = re.search(r"^_HOMES.*?^}", texts["geomosaic"], re.DOTALL | re.MULTILINE)
    native = [path for suffix in ("cpp", "hpp") for path in (ROOT / "geomosaic" / "kernels").rglob(f"*.{suffix}")]
    print(f"files of Python: {len(FILES)}, heads of one line among them: {len(heads)}")
    print(f"files under 80 lines, heads apart: {sum(lines[name] < 80 for name in FILES if name not in heads)}")
    print(f"lines: {sum(lines.values())}, of C++ {sum(len(path.read_text().splitlines()) for path in native)}")
    code, docstrings, comments = map(sum, zip(*counted, strict=True))
    print(f"lines of code without docstrings and comments: {code}; of docstrings: {docstrings}")
    print(f"lines with comments: {100 * comments / sum(lines.values()):.1f} %")
    print(f"modules in the longest chain of imports: {max(map(depth, FILES))}")
    print(f"functions and methods: {len(every)}, classes: {classes}")
    print(f"public functions that take parameters: {len(functions)}, undocumented: {len(without)} {without or ''}")
    print(f"options declared: {options}; flags of single commands: {flags}")
    print(f"public names: {public[0].count(': ') if public else 0}")
    print("most parameters:", *max(every), "; kernels apart:", *max(outside))
    print(f"functions with more than 8 parameters: {sum(count > 8 for count, _ in every)}")


if __name__ == "__main__":
    main()
