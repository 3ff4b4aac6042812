"""Northbound: database rows on their way to consumers beyond the gateway; the database is the only buffer.

feed (rows by their growing numbers, agent.storage.read.forward) -> forwarder (a thread a consumer) -> peer
(broker, database, archive) -> its acknowledgement -> cursor (table `consumers`, through the store's writer)
"""
