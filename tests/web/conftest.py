from tests.storage.conftest import memory

__all__ = ["memory"]
