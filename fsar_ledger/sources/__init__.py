"""The door: records of other systems, and of one's own robots as they happen, go into a ledger.

```
recorder    appends events to a run as they happen, durably, and resumes it
columns     what a source records, by types and columns: declared, told in lines of JSON, and as it is stored
adapter     what reads a format: records of a source, the events that follow from them, and its input
stored      what the ledger holds of a run from outside, and how far an import came
importing   files of a source -> a run: every record once, however often it was interrupted
mapping     an adapter from a file that says which record means which event
vda5050, rmf, ocel, otlp, mcap    the formats that come with the package
```
"""
