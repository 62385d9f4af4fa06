"""The library behind the ``lfnav`` command: each package is one stage of the pipeline.

Data flows upwards through the floors ``artifacts``, ``geometry``, ``dataset``, ``reconstruct``,
``lightfield``, ``render``, ``localize``, and ``dock``, ``report`` and ``experiments`` on top; a
package imports only from the floors below its own.
"""
