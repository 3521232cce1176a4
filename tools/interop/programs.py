"""The programs of others, pinned, each in a folder of its own."""
import json, os, pathlib, shutil, subprocess, sys, venv

# Name in the table, what the package index calls it, version, what is needed besides.
PIP = {
    "Open3D": ("open3d", "0.20.0", []),
    "MeshLab (pymeshlab)": ("pymeshlab", "2025.7.post1", []),
    "pypcd4": ("pypcd4", "1.5.1", []),
    "PyVista (VTK)": ("pyvista", "0.49.1", []),
    "trimesh": ("trimesh", "5.2.0", ["numpy==2.4.6"]),
    "Rerun": ("rerun-sdk", "0.41.0", []),
    "rosbags": ("rosbags", "0.11.9", []),
    "evo": ("evo", "1.38.1", []),
    "mcap (Python)": ("mcap", "1.6.0", []),
    "mcap-ros2-support": ("mcap-ros2-support", "0.6.0", []),
    "PINGVerter": ("pingverter", "2.1.7", []),
    "bluerobotics-ping": ("bluerobotics-ping", "0.2.5", ["future==1.0.0"]),
    "numpy": ("numpy", "2.4.6", []),
}
NPM = {"@mcap/core": ("@mcap/core", "2.2.2"), "splat-transform": ("@playcanvas/splat-transform", "3.7.0")}
APT = {"PCL": ("pcl-tools", "1.13.0+dfsg-3"), "CloudCompare": ("cloudcompare", "2.11.3-7.1")}
# What the orchestrator itself reads files with, apart from the tools under test.
JUDGE = ["numpy==2.4.6", "plyfile==1.1.5", "mcap==1.6.0"]
# Linked by Open3D and MeshLab; a machine without a screen may lack them.
SCREEN = ["libusb-1.0-0", "libgl1", "libegl1", "libgomp1", "libx11-6", "libopengl0", "libxrender1"]


def version_of(program):
    for known in (PIP, NPM, APT):
        if program in known:
            return known[program][1]
    raise KeyError(program)


def run(command, **more):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, **more)
    if done.returncode != 0:
        told = f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
        raise RuntimeError(told[-4000:])
    return done.stdout + done.stderr


def environment(folder, packages):
    """A virtual environment's interpreter; made once for these packages."""
    python, mark = folder / "bin/python", folder / "packages.json"
    if not (mark.exists() and json.loads(mark.read_text()) == packages):
        shutil.rmtree(folder, ignore_errors=True)
        venv.create(folder, with_pip=True)
        run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages])
        mark.write_text(json.dumps(packages))
    return python


class Programs:
    """Installs into a folder; what is there already is kept."""

    def __init__(self, folder, is_of_system):
        self.folder, self.is_of_system = folder, is_of_system
        self.of_screen = {}
        self.home = folder / "home"
        self.home.mkdir(parents=True, exist_ok=True)

    def python(self, program):
        name, version, more = PIP[program]
        return environment(self.folder / "pip" / name, [f"{name}=={version}", *more])

    def npm(self):
        """The folder of all node modules."""
        folder, wanted = self.folder / "npm", [f"{name}@{version}" for name, version in NPM.values()]
        mark = folder / "packages.json"
        if not (mark.exists() and json.loads(mark.read_text()) == wanted):
            folder.mkdir(exist_ok=True)
            (folder / "package.json").write_text("{}")
            run(["npm", "install", "--silent", "--no-audit", "--no-fund", *wanted], cwd=folder)
            mark.write_text(json.dumps(wanted))
        return folder / "node_modules"

    def apt(self):
        """The root under which the unpacked packages lie; `/` where they are the system's."""
        return self.unpacked("apt", [f"{name}={version}" for name, version in APT.values()])

    def unpacked(self, name, packages):
        if self.is_of_system:
            run(["apt-get", "install", "-qq", "-y", "--no-install-recommends", *packages])
            return pathlib.Path("/")
        folder = self.folder / name
        mark, root = folder / "packages.json", folder / "unpacked"
        if not (mark.exists() and json.loads(mark.read_text()) == packages):
            (folder / "partial").mkdir(parents=True, exist_ok=True)
            there = ["-o", f"Dir::Cache::archives={folder}"]
            run(["apt-get", "install", "-qq", "--download-only", "--reinstall", "-y", *there, *packages])
            for package in sorted(folder.glob("*.deb")):
                run(["dpkg", "-x", package, root])
            mark.write_text(json.dumps(packages))
        return root

    def variables(self):
        """Of a process: a home of its own, and no screen."""
        kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        return kept | {"HOME": str(self.home), "QT_QPA_PLATFORM": "offscreen", "PYTHONDONTWRITEBYTECODE": "1"}

    def with_screen(self, python, module):
        """Variables by which a library starts on a machine without a screen: what it links to is unpacked if missing."""
        if module not in self.of_screen:
            variables = self.variables()
            tried = subprocess.run([python, "-c", f"import {module}"], capture_output=True, env=variables)
            more = {} if tried.returncode == 0 else libraries(self.unpacked("screen", SCREEN))
            self.of_screen[module] = variables | more
        return self.of_screen[module]

    def with_packages(self):
        """Variables for the unpacked programs."""
        root = self.apt()
        if self.is_of_system:
            return self.variables()
        plugins = {"QT_PLUGIN_PATH": "qt5/plugins", "CC_PLUGIN_PATH": "cloudcompare/plugins"}
        found = {name: str(next(root.rglob(path))) for name, path in plugins.items()}
        return self.variables() | libraries(root) | found

    def binary(self, name):
        return self.apt() / "usr/bin" / name


def libraries(root):
    return {"LD_LIBRARY_PATH": ":".join(sorted({str(path.parent) for path in root.rglob("*.so*")}))}
