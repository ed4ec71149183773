"""Ten faults planted in an FMU: each is noticed by validation, or (token, missing source) by running or compiling it."""
import os
import subprocess
import sys
import tempfile
import zipfile

from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

path = sys.argv[1]
with zipfile.ZipFile(path) as z:
    files = {n: z.read(n) for n in z.namelist()}
xml = files["modelDescription.xml"].decode()


def between(start, end):
    i = xml.index(start)
    return xml[i : xml.index(end, i) + len(end)]


first_input = between('<ScalarVariable name="torque"', "</ScalarVariable>")
outputs = between("<Outputs>", "</Outputs>")
initial = between("<InitialUnknowns>", "</InitialUnknowns>")
faults = {
    "input without start": (first_input, first_input.replace(' start="60.0"', "")),
    "unit not defined": ('<Unit name="rpm"/>', ""),
    "output not listed": (outputs, outputs.replace(outputs[outputs.index("<Unknown") : outputs.index("/>") + 2], "", 1)),
    "initial unknowns missing": (initial, ""),
    "name twice": ('name="lambda"', 'name="torque"'),
    "wrong version": ('fmiVersion="2.0"', 'fmiVersion="9.0"'),
    "unknown causality": ('causality="input"', 'causality="intput"'),
    "attribute missing": (' modelName="dyn_map"', ""),
}


def write(folder, description, leave_out=None, with_binary=True):
    out = os.path.join(folder, "planted.fmu")
    with zipfile.ZipFile(out, "w") as z:
        for n, data in files.items():
            if n != leave_out and (with_binary or not n.startswith("binaries/")):
                z.writestr(n, description.encode() if n == "modelDescription.xml" else data)
    return out


def compiles(fmu):
    done = subprocess.run([sys.executable, "-m", "fmpy", "compile", fmu], capture_output=True, text=True)
    return done.returncode == 0, done.stdout + done.stderr


noticed = 0
with tempfile.TemporaryDirectory() as folder:
    # Without a fault every check passes, so that what they notice below is the fault.
    sound = write(folder, xml)
    assert not validate_fmu(sound)
    simulate_fmu(sound, stop_time=0.3, step_size=0.03, output_interval=0.03)
    passes, said = compiles(write(folder, xml, with_binary=False))
    assert passes, said
    for fault, (old, new) in faults.items():
        assert old in xml and old != new, fault
        try:
            problems = validate_fmu(write(folder, xml.replace(old, new, 1)))
        except Exception as e:  # a description that cannot even be read
            problems = [str(e)]
        assert problems, f"{fault}: not noticed"
        noticed += 1
    i = xml.index('guid="{') + 7
    wrong = write(folder, xml[:i] + ("0" if xml[i] != "0" else "1") + xml[i + 1 :])
    try:
        simulate_fmu(wrong, stop_time=0.3, step_size=0.03, output_interval=0.03)
        raise SystemExit("wrong guid: not noticed")
    except SystemExit:
        raise
    except Exception:
        noticed += 1
    bare = write(folder, xml, leave_out="sources/dyn_map.c", with_binary=False)
    assert not compiles(bare)[0], "missing source: not noticed"
    noticed += 1
print(f"FMU: {noticed} of 10 planted faults noticed")
