"""Input from outside: records of other systems, and of one's own robots as they happen, go into a ledger.

```
recorder    appends events to a run as they happen, durably, and resumes it
columns     what a source records, by types and columns: as declared, as lines of JSON, and as stored
adapter     readers of formats: the records of a source, the events that follow from them, and the inputs
stored      the state of a run from outside in the ledger, and how far an import came
importing   files of a source -> a run: every record once, however often it was interrupted
mapping     an adapter from a file that says which record means which event
vda5050, rmf, ocel, otlp, mcap    the formats that come with the package
```
"""
