/* Write the events of a run as lines of JSON, straight from their structs, in one call.
 *
 * Only what is plain is written: events of types that are known, with values of the classes, sizes and lists that their
 * fields allow, and text of printable ASCII. For anything else the answer is None, and Python code says what is wrong, or
 * writes it (`compiled.py`). Tests require both to agree.
 */

#include "_codec.h"

/* What a column holds: a value of the event, or one that every row has. As in `compiled.py`. */
enum { STRING, INTEGER, BOOLEAN, STRINGS, RUN_ID, SEQ, TIME_US, CAUSED_BY, TYPE };

/* How writing went on. */
enum { FAILED = -1, WRITTEN, NOT_PLAIN };

/* What a row has beside its event. */
typedef struct {
    PyObject *run_id, *time, *cause;
    long long seq;
} Place;

static int put_integer(Written *out, PyObject *value, long long least, long long most) {
    int is_beyond = 0;
    if (!PyLong_CheckExact(value)) return NOT_PLAIN;
    long long number = PyLong_AsLongLongAndOverflow(value, &is_beyond);
    if (is_beyond || number < least || number > most) return NOT_PLAIN;
    return put_number(out, number);
}

/* Write text of printable ASCII as JSON, which escapes the quotation mark and the backslash. */
static int put_text(Written *out, PyObject *value) {
    Py_ssize_t size;
    int escapes = 0;
    if (!PyUnicode_CheckExact(value)) return NOT_PLAIN;
    const char *text = PyUnicode_AsUTF8AndSize(value, &size);
    if (text == NULL) return PyErr_Clear(), NOT_PLAIN; /* it has surrogates */
    for (const char *at = text; at < text + size; at++) {
        if (*at < ' ' || *at > '~') return NOT_PLAIN; /* char may be signed: both end there */
        escapes += *at == '"' || *at == '\\';
    }
    int how = put(out, "\"", 1);
    for (const char *end = text + size; how == WRITTEN && escapes; escapes--) {
        const char *at = text;
        while (*at != '"' && *at != '\\') at++;
        how = put(out, text, (size_t)(at - text));
        if (how == WRITTEN) how = put(out, *at == '"' ? "\\\"" : "\\\\", 2);
        text = at + 1, size = end - text;
    }
    if (how == WRITTEN) how = put(out, text, (size_t)size);
    return how == WRITTEN ? put(out, "\"", 1) : how;
}

static int put_texts(Written *out, PyObject *values) {
    if (!PyTuple_CheckExact(values)) return NOT_PLAIN;
    int how = put(out, "[", 1);
    for (Py_ssize_t at = 0; how == WRITTEN && at < PyTuple_Size(values); at++) {
        if (at) how = put(out, ",", 1);
        if (how == WRITTEN) how = put_text(out, PyTuple_GetItem(values, at));
    }
    return how == WRITTEN ? put(out, "]", 1) : how;
}

static int put_value(Written *out, long kind, PyObject *value, PyObject *values) {
    if (kind == INTEGER) return put_integer(out, value, -MAX_INTEGER, MAX_INTEGER);
    if (kind == STRINGS) return put_texts(out, value);
    if (kind == BOOLEAN) {
        if (value != Py_True && value != Py_False) return NOT_PLAIN;
        return value == Py_True ? put(out, "true", 4) : put(out, "false", 5);
    }
    int how = put_text(out, value);
    if (how != WRITTEN || values == Py_None) return how;
    int is_listed = PySet_Contains(values, value);
    return is_listed < 0 ? FAILED : is_listed ? WRITTEN : NOT_PLAIN;
}

static int put_place(Written *out, long kind, const Place *place, PyObject *tag) {
    if (kind == SEQ) return put_number(out, place->seq);
    if (kind == TIME_US) return put_integer(out, place->time, -MAX_INTEGER, MAX_INTEGER);
    if (kind == CAUSED_BY) return put_integer(out, place->cause, 0, place->seq - 1);
    return put_text(out, kind == RUN_ID ? place->run_id : tag);
}

/* A column of an event type: its kind, what comes before its value, where the event has it, and what it may be. Where its
 * objects keep the member and the field is 0 if that is not known. */
typedef struct {
    long kind;
    const char *name;
    Py_ssize_t name_size;
    PyObject *member, *part, *field, *values;
    int is_nullable;
    Py_ssize_t member_at, field_at;
} Column;

/* A class of events, or of parts of them. Its objects are a head and then `fields` references; 0 if they are not. Its marks
 * are told of a run whose events have it, but for that which begins the run. */
typedef struct {
    PyObject *class;
    Column *columns;
    Py_ssize_t count, fields;
    unsigned long marks;
    PyObject *probe, *probes; /* while the types are made */
} Type;

/* The types that are known, found by the address of their class; `given` is what they were made from. There are at most
 * half as many as slots. */
typedef struct {
    PyObject *given;
    Type *types;
    size_t slots;
} Types;

#define TYPES "fsar_ledger.ledger.rows._encoding.types"

static Type *type_of(const Types *all, PyObject *class) {
    size_t slot = ((uintptr_t)class >> 4 ^ (uintptr_t)class >> 12) & (all->slots - 1);
    while (all->types[slot].class != NULL && all->types[slot].class != class) slot = (slot + 1) & (all->slots - 1);
    return all->types + slot;
}

#if defined(__GNUC__) || defined(__clang__)
#define FETCH(place) __builtin_prefetch(place)
#else
#define FETCH(place) ((void)(place))
#endif
#define LINE_BYTES 64
#define HEAD_WORDS (sizeof(PyObject) / sizeof(PyObject *))

/* Let the processor fetch what this object refers to, while something else is done. */
static void fetch_fields(const Types *all, PyObject *object) {
    const Type *type = type_of(all, (PyObject *)Py_TYPE(object));
    PyObject **fields = (PyObject **)object + HEAD_WORDS;
    for (Py_ssize_t at = 0; at < type->fields; at++) FETCH(fields[at]), FETCH((char *)fields[at] + LINE_BYTES);
}

/* The same for its parts, which were fetched before. */
static void fetch_parts(const Types *all, PyObject *object) {
    const Type *type = type_of(all, (PyObject *)Py_TYPE(object));
    PyObject **fields = (PyObject **)object + HEAD_WORDS;
    for (Py_ssize_t at = 0; at < type->fields; at++)
        if (fields[at] != NULL) fetch_fields(all, fields[at]);
}

static void fetch_event(PyObject *event) {
    const char *place = (const char *)event;
    FETCH(place), FETCH(place + LINE_BYTES), FETCH(place + 2 * LINE_BYTES);
}

/* Events that were made long ago are in no cache, nor is what they refer to: fetch those that come next, step by step. */
static void fetch_ahead(const Types *all, PyObject *events, Py_ssize_t row) {
    if (row + 6 < PyList_Size(events)) fetch_event(PyList_GetItem(events, row + 6));
    if (row + 4 < PyList_Size(events)) fetch_fields(all, PyList_GetItem(events, row + 4));
    if (row + 2 < PyList_Size(events)) fetch_parts(all, PyList_GetItem(events, row + 2));
}

/* The same for the first ones, each step for all of them, so that none waits for another. */
static void fetch_first(const Types *all, PyObject *events) {
    Py_ssize_t rows = PyList_Size(events);
    for (Py_ssize_t row = 0; row < rows && row < 6; row++) fetch_event(PyList_GetItem(events, row));
    for (Py_ssize_t row = 0; row < rows && row < 4; row++) fetch_fields(all, PyList_GetItem(events, row));
    for (Py_ssize_t row = 0; row < rows && row < 2; row++) fetch_parts(all, PyList_GetItem(events, row));
}

/* Return a new reference to what the object has there, or under this name; NULL if it has nothing. */
static PyObject *attribute(PyObject *object, Py_ssize_t at, PyObject *name) {
    if (!at) return PyObject_GetAttr(object, name);
    PyObject *found = ((PyObject **)object)[at];
    Py_XINCREF(found);
    return found;
}

/* Return a new reference to the value of the event for this column; NULL if it has none, or its part is of another class. */
static PyObject *value_of(PyObject *event, const Column *column) {
    PyObject *found = attribute(event, column->member_at, column->member);
    if (found == NULL || column->part == Py_None) return found;
    PyObject *value = NULL;
    if ((PyObject *)Py_TYPE(found) == column->part) value = attribute(found, column->field_at, column->field);
    Py_DECREF(found);
    return value;
}

/* Write a member of the row, with what comes before it. */
static int put_column(Written *out, const Column *column, PyObject *event, const Place *place, char *before) {
    int is_value = column->kind < RUN_ID;
    PyObject *value = is_value ? value_of(event, column) : NULL;
    if (is_value && value == NULL) return PyErr_Clear(), NOT_PLAIN;
    int how = WRITTEN;
    if (is_value ? value == Py_None : column->kind == CAUSED_BY && place->cause == Py_None) {
        how = !is_value || column->is_nullable ? WRITTEN : NOT_PLAIN;
    } else {
        how = put(out, before, 1);
        *before = ',';
        if (how == WRITTEN) how = put(out, column->name, column->name_size);
        if (how == WRITTEN)
            how = is_value ? put_value(out, column->kind, value, column->values)
                           : put_place(out, column->kind, place, column->field);
    }
    Py_XDECREF(value);
    return how;
}

static int put_row(Written *out, const Types *types, PyObject *event, const Place *place, unsigned long *marks) {
    const Type *type = type_of(types, (PyObject *)Py_TYPE(event));
    if (type->columns == NULL) return NOT_PLAIN;
    if (place->seq) *marks |= type->marks;
    char before = '{';
    int how = WRITTEN;
    for (const Column *column = type->columns; how == WRITTEN && column < type->columns + type->count; column++)
        how = put_column(out, column, event, place, &before);
    return how == WRITTEN ? put(out, "}\n", 2) : how;
}

/* Take (kind, name, member, part, field, nullable, values) apart. What it holds is kept by `given`. */
static int take_column(Column *column, PyObject *given) {
    if (!PyTuple_Check(given)) return PyErr_SetString(PyExc_TypeError, "a column: expected a tuple of 7"), -1;
    return PyArg_ParseTuple(given, "ly#OOOpO", &column->kind, &column->name, &column->name_size, &column->member,
                            &column->part, &column->field, &column->is_nullable, &column->values)
               ? 0
               : -1;
}

/* Return how many references the objects of this class are, after their head; 0 if they are anything else. */
static Py_ssize_t fields_of(PyObject *class) {
    PyObject *names = PyObject_GetAttrString(class, "__struct_fields__");
    PyObject *bytes = PyObject_GetAttrString(class, "__basicsize__");
    Py_ssize_t count = names != NULL && PyTuple_Check(names) ? PyTuple_Size(names) : 0;
    Py_ssize_t size = bytes != NULL ? PyLong_AsSsize_t(bytes) : 0;
    Py_XDECREF(names), Py_XDECREF(bytes);
    PyErr_Clear();
    return size == (Py_ssize_t)(sizeof(PyObject) + count * sizeof(PyObject *)) ? count : 0;
}

/* Make an object of this type with another object in each field, which `probes` has by name. Nothing is made, without an
 * error, if that cannot be. */
static void probe(Type *type) {
    PyObject *names = PyObject_GetAttrString(type->class, "__struct_fields__"), *none = PyTuple_New(0);
    type->probes = PyDict_New();
    for (Py_ssize_t at = 0; none != NULL && type->probes != NULL && at < type->fields; at++) {
        PyObject *other = PyObject_CallObject((PyObject *)&PyBaseObject_Type, NULL);
        if (other == NULL || PyDict_SetItem(type->probes, PyTuple_GetItem(names, at), other) < 0) PyErr_Clear();
        Py_XDECREF(other);
    }
    if (none != NULL && type->probes != NULL && type->fields) type->probe = PyObject_Call(type->class, none, type->probes);
    Py_XDECREF(names), Py_XDECREF(none);
    PyErr_Clear();
}

static void end_probe(Type *type) {
    Py_CLEAR(type->probe);
    Py_CLEAR(type->probes);
}

/* Return where the objects of this type keep the field of this name, in words from their beginning; 0 if that is not seen.
 * To read it there takes a tenth of the time of asking for it. */
static Py_ssize_t place_in(const Type *type, PyObject *name) {
    PyObject *other = type->probe != NULL ? PyDict_GetItemWithError(type->probes, name) : NULL;
    Py_ssize_t place = 0;
    for (Py_ssize_t at = HEAD_WORDS; other != NULL && at < (Py_ssize_t)HEAD_WORDS + type->fields; at++)
        if (((PyObject **)type->probe)[at] == other) place = at;
    PyErr_Clear();
    return place;
}

static void release(PyObject *capsule) {
    Types *all = PyCapsule_GetPointer(capsule, TYPES);
    for (size_t slot = 0; slot < all->slots; slot++) end_probe(all->types + slot), free(all->types[slot].columns);
    Py_XDECREF(all->given);
    free(all->types), free(all);
}

static Type *add_type(const Types *all, PyObject *class) {
    Type *type = type_of(all, class);
    if (type->class == NULL) type->class = class, type->fields = fields_of(class), probe(type);
    return type;
}

static int take_columns(const Types *all, PyObject *class, PyObject *given) {
    PyObject *columns;
    Type *type = add_type(all, class);
    if (!PyTuple_Check(given)) return PyErr_SetString(PyExc_TypeError, "a type: expected its marks and columns"), -1;
    if (!PyArg_ParseTuple(given, "kO!", &type->marks, &PyTuple_Type, &columns)) return -1;
    type->columns = calloc((size_t)PyTuple_Size(columns) + 1, sizeof *type->columns);
    if (type->columns == NULL) return PyErr_NoMemory(), -1;
    for (; type->count < PyTuple_Size(columns); type->count++) {
        Column *column = type->columns + type->count;
        if (take_column(column, PyTuple_GetItem(columns, type->count)) < 0) return -1;
        if (column->kind >= RUN_ID) continue;
        column->member_at = place_in(type, column->member);
        if (column->part != Py_None) column->field_at = place_in(add_type(all, column->part), column->field);
    }
    return 0;
}

/* Return the types of {class: (marks, (column, ...))} as `lines` takes them. The tuples must not change, and cannot. */
PyObject *event_types(PyObject *module, PyObject *given) {
    PyObject *class, *type;
    Py_ssize_t at = 0, count = 1;
    (void)module;
    if (!PyDict_Check(given)) return PyErr_SetString(PyExc_TypeError, "event_types: expected a dict"), NULL;
    Types *all = calloc(1, sizeof *all);
    PyObject *capsule = all == NULL ? PyErr_NoMemory() : PyCapsule_New(all, TYPES, release);
    if (capsule == NULL) return free(all), NULL;
    if ((all->given = PyDict_Copy(given)) == NULL) return Py_DECREF(capsule), NULL;
    while (PyDict_Next(all->given, &at, &class, &type)) { /* each column may have a part */
        PyObject *columns = PyTuple_Check(type) && PyTuple_Size(type) == 2 ? PyTuple_GetItem(type, 1) : NULL;
        count += 1 + (columns != NULL && PyTuple_Check(columns) ? PyTuple_Size(columns) : 0);
    }
    for (all->slots = 2; all->slots < 2 * (size_t)count;) all->slots *= 2;
    all->types = calloc(all->slots, sizeof *all->types);
    if (all->types == NULL) return all->slots = 0, Py_DECREF(capsule), PyErr_NoMemory();
    for (at = 0; PyDict_Next(all->given, &at, &class, &type);)
        if (take_columns(all, class, type) < 0) return Py_DECREF(capsule), NULL;
    for (size_t slot = 0; slot < all->slots; slot++) end_probe(all->types + slot);
    return capsule;
}

PyObject *write_events(PyObject *module, PyObject *args) {
    PyObject *capsule, *times, *causes, *events, *made = NULL;
    Place place;
    Written out = {NULL, 0, 0};
    unsigned long marks = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "OOLO!O!O!", &capsule, &place.run_id, &place.seq, &PyList_Type, &times, &PyList_Type, &causes,
                          &PyList_Type, &events))
        return NULL;
    const Types *all = PyCapsule_GetPointer(capsule, TYPES);
    if (all == NULL) return NULL;
    Py_ssize_t rows = PyList_Size(events);
    int how = PyList_Size(times) == rows && PyList_Size(causes) == rows ? WRITTEN : NOT_PLAIN;
    fetch_first(all, events);
    for (Py_ssize_t row = 0; how == WRITTEN && row < rows; row++, place.seq++) {
        fetch_ahead(all, events, row);
        PyObject *event = PyList_GetItem(events, row);
        place.time = PyList_GetItem(times, row), place.cause = PyList_GetItem(causes, row);
        if (event == NULL || place.time == NULL || place.cause == NULL) {
            how = FAILED; /* getting an attribute ran Python code, and that made the lists shorter */
            break;
        }
        Py_INCREF(event), Py_INCREF(place.time), Py_INCREF(place.cause);
        how = put_row(&out, all, event, &place, &marks);
        Py_DECREF(event), Py_DECREF(place.time), Py_DECREF(place.cause);
    }
    if (how == WRITTEN) made = Py_BuildValue("(y#k)", rows ? out.data : "", (Py_ssize_t)out.size, marks);
    if (how == NOT_PLAIN) Py_INCREF(Py_None), made = Py_None;
    if (how == FAILED && !PyErr_Occurred()) PyErr_NoMemory();
    free(out.data);
    return made;
}
