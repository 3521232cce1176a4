#!/usr/bin/env python3
"""Opens every kind of file that EchoSplat writes in the programs its users have, and writes what arrives there into
docs/formats.md. Ends with 1 where a program that claims to read a file decodes another count than was written."""
import argparse, os, pathlib, sys, tempfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    kept = "where programs and files are kept; a passing one without"
    parser.add_argument("folder", nargs="?", type=pathlib.Path, help=kept)
    parser.add_argument("--program", type=pathlib.Path, default=ROOT / "target/release/echosplat")
    parser.add_argument("--page", type=pathlib.Path, default=ROOT / "docs/formats.md")
    named = "programs and files with this in their name; the page stays as it is"
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help=named)
    installed = "install PCL and CloudCompare rather than unpack them"
    parser.add_argument("--system-packages", action="store_true", help=installed)
    return parser.parse_args()


def in_environment(folder):
    """This script again, with the libraries that it reads files with itself."""
    from programs import JUDGE, environment

    python = environment(folder / "judge", JUDGE)
    if pathlib.Path(sys.prefix).resolve() != (folder / "judge").resolve():
        os.execv(python, [str(python), *sys.argv])


def main():
    asked = arguments()
    if asked.folder is None:
        asked.folder = pathlib.Path(tempfile.mkdtemp(prefix="interop-"))
        # The next process is given it too.
        sys.argv.insert(1, str(asked.folder))
    asked.folder = asked.folder.resolve()
    in_environment(asked.folder)

    import files, page, reading
    from programs import Programs

    product = files.Product(asked.program)
    folders = files.write_all(product, asked.folder / "files")
    programs = Programs(asked.folder, asked.system_packages)
    wanted = lambda *names: all(any(word.lower() in name.lower() for name in names) for word in asked.only)
    points = reading.points(programs, product, folders, wanted)
    messages = reading.messages(programs, product, folders[files.RECORDED], wanted)
    text = page.tables(points, messages)
    print(text)
    if not asked.only:
        page.put(asked.page, text)
    faults = [fault for row in points + messages for fault in row.faults]
    for fault in faults:
        print("FAULT", fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
