"""The parts of a network's description by name, as the builder and the checks of it read them."""

from __future__ import annotations

from snnrl.configuration.functions import function
from snnrl.errors import ConfigError
from snnrl.model.neurons import IZHIKEVICH, TIME_CELL, NeuronModel
from snnrl.model.synapses import DOPAMINE
from snnrl.schema import (
    HomeostasisConfig,
    ModulatorConfig,
    NetworkConfig,
    NeuronConfig,
    PlasticityConfig,
    SetConfig,
    SynapseConfig,
)


def rules(config: NetworkConfig) -> dict[str, PlasticityConfig]:
    """The plasticity rules by name; the one without a name is that of whoever names none."""
    return {"": config.plasticity, **config.rules}


def rule_key(name: str) -> str:
    """Where the rule of that name is configured."""
    return f"network.rules.{name}" if name else "network.plasticity"


def modulators(config: NetworkConfig) -> dict[str, ModulatorConfig]:
    """All modulators by name, dopamine first."""
    return ({} if config.dopamine is None else {DOPAMINE: config.dopamine}) | config.modulators


def modulator_key(name: str) -> str:
    """Where the modulator of that name is configured."""
    return "network.dopamine" if name == DOPAMINE else f"network.modulators.{name}"


def neuron_model(key: str, config: NeuronConfig) -> NeuronModel:
    """The model that a configuration names.

    Raises:
        ConfigError: there is no such model.
    """
    found = function(f"{key}.model", config.model, {"izhikevich": IZHIKEVICH, "time_cell": TIME_CELL})
    try:
        return found if isinstance(found, NeuronModel) else NeuronModel(found)
    except ValueError as error:
        raise ConfigError(f"{key}.model", config.model, str(error)) from error


def neuron_parameters(config: NeuronConfig) -> dict[str, tuple[float, float]]:
    """Value and spread of each parameter that is given."""
    own = {name: (getattr(config, name), getattr(config, f"{name}_spread", 0.0)) for name in "abcd"}
    given = {name: (value, config.spreads.get(name, 0.0)) for name, value in config.parameters.items()}
    return {name: pair for name, pair in {**own, **given}.items() if pair[0] is not None}


def homeostatic_set(config: HomeostasisConfig, name: str) -> SetConfig:
    """Everything about one set: its own, or what holds for all."""
    own = vars(config.per_set.get(name, SetConfig()))
    return SetConfig(**{key: getattr(config, key) if value is None else value for key, value in own.items()})


def weight_bounds(config: NetworkConfig, kind: SynapseConfig) -> tuple[float, float]:
    """Least and largest weight (mV) of a kind of synapse, if it is plastic."""
    rule = rules(config)[kind.rule]
    return rule.weight_min, rule.weight_max
