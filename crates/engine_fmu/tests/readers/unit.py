"""A co-simulation FMU as an object with set, get, step, save and restore, for both versions of FMI, over FMPy."""
import shutil

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave


class Unit:
    def __init__(self, path):
        self.about = read_model_description(path)
        self.folder = extract(path)
        self.two = self.about.fmiVersion == "2.0"
        kind = FMU2Slave if self.two else FMU3Slave
        token = self.about.guid if self.two else self.about.instantiationToken
        self.fmu = kind(
            guid=token, unzipDirectory=self.folder, modelIdentifier=self.about.coSimulation.modelIdentifier,
            instanceName="unit",
        )
        self.fmu.instantiate()
        if self.two:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()
        self.time = 0.0

    def names(self, causality):
        return [v.name for v in self.about.modelVariables if v.causality == causality]

    def references(self, causality):
        return [v.valueReference for v in self.about.modelVariables if v.causality == causality]

    def set(self, references, values):
        (self.fmu.setReal if self.two else self.fmu.setFloat64)(references, [float(v) for v in values])

    def get(self, references):
        return (self.fmu.getReal if self.two else self.fmu.getFloat64)(references)

    def step(self, dt):
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=dt)
        self.time += dt

    def save(self):
        state = self.fmu.getFMUstate() if self.two else self.fmu.getFMUState()
        data = self.fmu.serializeFMUstate(state) if self.two else self.fmu.serializeFMUState(state)
        return data, self.time

    def restore(self, saved):
        data, self.time = saved
        if self.two:
            self.fmu.setFMUstate(self.fmu.deSerializeFMUstate(data))
        else:
            self.fmu.setFMUState(self.fmu.deserializeFMUState(data))

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)
