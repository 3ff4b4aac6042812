"""Electrical ladders, motors and voice coils, thermal and hydraulic networks: stores, losses, exchanges."""

from sim_bus.rig.domains.built import Built, Network, Raw, Values

GROUND = "ground"
GRAVITY = 9.80665  # fixed by ISO 80000-3, m/s^2


def ladder_values(raw: Raw) -> dict[str, float]:
    """Return R1, L1, C1, R2 ... and load."""
    values = {
        f"{key}{i}": stage[key] for i, stage in enumerate(raw["stage"], 1) for key in "RLC" if key in stage
    }
    return values | ({"load": raw["load"]} if "load" in raw else {})


def ladder(raw: Raw, values: Values) -> Built:
    """Return coils that exchange power with capacitors, and what resistors lose."""
    net = Network(outside={"source": ("voltage", "source")})
    before = "source"
    for i, stage in enumerate(raw["stage"], 1):
        coil, shunt = f"L{i}", f"C{i}"
        net.stores[shunt] = values[shunt]
        net.readings["voltage", shunt] = {shunt: 1.0}
        if "L" not in stage:
            net.lose(1.0 / values[f"R{i}"], {before: 1.0, shunt: -1.0})
        else:
            net.stores[coil] = values[coil]
            net.lose(values[f"R{i}"], {coil: 1.0})
            net.exchange(1.0, coil, shunt)
            net.readings["current", coil] = {coil: 1.0}
            if before == "source":
                net.efforts["voltage", "source"] = {coil: 1.0}
            else:
                net.exchange(1.0, before, coil)
        before = shunt
    if "load" in values:
        net.lose(1.0 / values["load"], {before: 1.0})
    return net.built()


def motor_values(raw: Raw) -> dict[str, float]:
    """Return the constants of a motor or of a voice coil."""
    return {key: raw[key] for key in ("RLKJb" if raw["kind"] == "dc-motor" else "RLKmbk")}


def motor(_raw: Raw, values: Values) -> Built:
    """Return a winding and a rotor that exchange power by K; the angle stores nothing and follows."""
    return _moving(values, "armature", ("J", "torque", "speed", "shaft"), ("angle", "angle"))


def voice_coil(_raw: Raw, values: Values) -> Built:
    """Return a winding, what moves, and its place, which the spring pulls back."""
    built = _moving(values, "winding", ("m", "force", "velocity", "coil"), ("position", "displacement"))
    built.F[1, 2] = -values["k"] / values["m"]
    return built


def _moving(values: Values, winding: str, mover: tuple[str, str, str, str], place: tuple[str, str]) -> Built:
    """Return a winding, what it moves (inertia, effort, motion, where), and the place with its quantity."""
    inertia, effort, motion, at = mover
    state, quantity = place
    net = Network(stores={"current": values["L"], motion: values[inertia], state: 1.0})
    net.lose(values["R"], {"current": 1.0})
    net.lose(values["b"], {motion: 1.0})
    net.exchange(values["K"], "current", motion)
    net.efforts |= {("voltage", "winding"): {"current": 1.0}, (effort, at): {motion: 1.0}}
    net.readings |= {(motion, at): {motion: 1.0}, (quantity, at): {state: 1.0}}
    net.readings["current", winding] = {"current": 1.0}
    built = net.built()
    built.F[2, 1] = 1.0
    return built


def thermal_values(raw: Raw) -> dict[str, float]:
    """Return capacities, conductances and resistances."""
    return _named(raw, "capacity", "conductance", "resistance")


def thermal(raw: Raw, values: Values) -> Built:
    """Return heat capacities that lose to each other and to what stays as warm as it is given."""
    net = Network(outside={name: ("temperature", name) for name in raw.get("boundary", ())})
    for row in raw["capacity"]:
        name = row["name"]
        net.stores[name] = values[name]
        net.efforts["power", name] = net.readings["temperature", name] = {name: 1.0}
    for row in raw.get("conductance", ()):
        net.lose(values[row["name"]], _difference(row))
    for row in raw.get("resistance", ()):
        net.lose(1.0 / values[row["name"]], _difference(row))
    return net.built()


def hydraulic_values(raw: Raw) -> dict[str, float]:
    """Return areas, capacities, resistances, inertances and <line>.R."""
    own = {f"{row['name']}.R": row["resistance"] for row in raw.get("line", ()) if row.get("resistance")}
    return _named(raw, "tank", "vessel", "restriction", "line") | own


def hydraulic(raw: Raw, values: Values) -> Built:
    """Return volumes that exchange power with the flows of lines and lose it in restrictions."""
    net = Network(outside={name: ("pressure", name) for name in raw.get("boundary", ())})
    weight = raw.get("density", 1000.0) * GRAVITY
    for key, by in (("tank", weight), ("vessel", 1.0)):
        for row in raw.get(key, ()):
            name = row["name"]
            net.stores[name] = values[name] / by
            net.efforts["flow", name] = net.readings["pressure", name] = {name: 1.0}
            if key == "tank":
                net.readings["level", name] = {name: 1.0 / weight}
    for row in raw.get("restriction", ()):
        net.lose(1.0 / values[row["name"]], _difference(row))
    for row in raw.get("line", ()):
        _line(net, row, values)
    return net.built()


def _line(net: Network, row: Raw, values: Values) -> None:
    name = row["name"]
    net.stores[name] = values[name]
    net.readings["flow", name] = {name: 1.0}
    net.lose(values.get(f"{name}.R", 0.0), {name: 1.0})
    for end, sign in _difference(row).items():
        if end in net.stores:
            net.exchange(sign, end, name)
        elif end in net.outside:
            net.efforts.setdefault(net.outside[end], {})[name] = sign


def _difference(row: Raw) -> dict[str, float]:
    """Return from where to where; what is neither store nor boundary (ground) is 0."""
    one, other = row["between"]
    return {one: 1.0, other: -1.0}


def _named(raw: Raw, *keys: str) -> dict[str, float]:
    return {row["name"]: row["nominal"] for key in keys for row in raw.get(key, ())}
