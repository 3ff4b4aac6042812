"""What is handed out, made from a commit: wheel, sdist, `.deb`, bill of materials, man page, completion.

    python -m deploy.package DIST            (make package)

    source    wheel and sdist, the same bytes whoever builds them
    release   the environment of a gateway: interpreter's place, locked dependencies, deltak, byte code
    bill      CycloneDX bill of materials of what the environment holds
    manual    deltak(1) and the shells' completion, from the commands themselves
    deb       all of it and what deploy/ holds as a Debian package

Nothing here is part of the product: it needs the extra `package` and a Debian with /usr/bin/python3.11.
"""
