"""Plants of other domains than mechanics: templates that become linear models in their own words and units.

A file a domain; each says in `plant` which elements stand where in E x' = F x + G u and what may drive and be
read:

    electrical rlc-ladder · electromechanical dc-motor, voice-coil · thermal · hydraulic · rotating torsional
    · frame
"""
