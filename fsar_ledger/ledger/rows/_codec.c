/* The hot paths of the codec, each with a twin in Python (`compiled.py`): events to rows, columns to rows, rows to columns.
 * A machine without a compiler goes without. */

#include "_codec.h"

static PyMethodDef METHODS[] = {
    {"event_types", event_types, METH_O, "Return event types and their columns as write_events takes them."},
    {"write_events", write_events, METH_VARARGS,
     "Return the events of a run as lines of JSON, and their marks; None if they are not plain."},
    {"write_rows", write_rows, METH_VARARGS, "Return so many rows as lines of JSON, from their columns."},
    {"read_rows", read_rows, METH_VARARGS, "Return the columns of these lines; None if they are not plain."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_codec", NULL, 0, METHODS, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__codec(void) { return PyModule_Create(&MODULE); }
