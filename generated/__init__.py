"""The controllers that ship: per folder the generated C, its header and the manifest. Never edited by hand."""
