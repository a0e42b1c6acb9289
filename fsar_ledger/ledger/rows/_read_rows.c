/* Take lines of canonical JSON, the rows of a ledger, apart into columns, in one call.
 *
 * Only what is plain is taken: members that are columns, in order, with values as they are written, and text of printable
 * ASCII. For anything else the answer is None, and Python code reads it, or says what is wrong
 * (`compiled.py`). Tests require both to agree. No object of Python is touched meanwhile, so other threads run.
 */

#include "_codec.h"

#define MAX_DIGITS 16
#define MAX_BYTES 0x7fffffff /* of all lines: offsets of Arrow have 32 bits */
#define NAME_SLOTS 1024
#define MAX_NAMES (NAME_SLOTS / 2)
#define MAX_PROBES 256 /* more, and someone chose texts of one hash */

/* What a column holds. As in `compiled.py`. */
enum { STRING, INTEGER, BOOLEAN, STRINGS };

/* How reading went on. */
enum { READ, NOT_PLAIN, NO_MEMORY };

/* A text as the lines have it, and as what it says: the same bytes unless JSON escapes some; then those are its own. */
typedef struct {
    const char *at, *said;
    int32_t size, said_size;
    uint32_t hash;
} Text;

/* Each text once; `slots` hold places in `texts`, from 1. */
typedef struct {
    Text *texts;
    int32_t *slots;
    int32_t count, room;
    uint32_t mask;
} Texts;

/* A column: a bit for each row that has a value, and the values. Those of texts are places in `Texts`, then in order; those
 * of lists lie one after the other, the row's from ends[row] to ends[row + 1]. */
typedef struct {
    const char *name;
    Py_ssize_t name_size;
    int kind;
    uint8_t *is_there, *bits;
    int32_t *places, *ends;
    int64_t *integers;
    size_t items, items_room;
    int64_t ended;
    char *words;
    int32_t *word_ends, words_count;
} Column;

typedef struct {
    Column *columns;
    int count;
    int16_t slots[NAME_SLOTS];
    int64_t rows;
    Texts texts;
} Table;

static uint64_t word_at(const char *at) {
    uint64_t word;
    return memcpy(&word, at, sizeof word), word;
}

/* Return up to 8 bytes as a number, without a loop: of 4 to 7 bytes, two halves that may overlap. */
static uint64_t few(const char *at, size_t size) {
    uint32_t first, last;
    if (size == 8) return word_at(at);
    if (size >= 4) {
        memcpy(&first, at, 4), memcpy(&last, at + size - 4, 4);
        return (uint64_t)first << 32 | last;
    }
    return size ? (uint64_t)(uint8_t)at[0] << 16 | (uint64_t)(uint8_t)at[size / 2] << 8 | (uint8_t)at[size - 1] : 0;
}

static uint32_t hash_of(const char *at, size_t size) {
    uint64_t hash = size * 0x9e3779b97f4a7c15u;
    for (; size > 8; at += 8, size -= 8) {
        hash = (hash ^ word_at(at)) * 0xff51afd7ed558ccdu;
        hash ^= hash >> 32;
    }
    hash = (hash ^ few(at, size)) * 0xc4ceb9fe1a85ec53u;
    return (uint32_t)((hash ^ hash >> 32) * 0xff51afd7ed558ccdu >> 32); /* else the last bytes would not move the slot */
}

static int grow_texts(Texts *all) {
    int32_t room = all->room ? all->room * 2 : 1024;
    Text *texts = realloc(all->texts, (size_t)room * sizeof *texts);
    if (texts == NULL) return NO_MEMORY;
    all->texts = texts, all->room = room, all->mask = (uint32_t)room * 2 - 1;
    free(all->slots);
    all->slots = calloc((size_t)room * 2, sizeof *all->slots);
    if (all->slots == NULL) return NO_MEMORY;
    for (int32_t place = 0; place < all->count; place++) {
        uint32_t slot = texts[place].hash & all->mask;
        while (all->slots[slot]) slot = (slot + 1) & all->mask;
        all->slots[slot] = place + 1;
    }
    return READ;
}

static int is_printable(const char *at, size_t size) {
    int is_odd = 0;
    for (size_t byte = 0; byte < size; byte++) /* without a branch, so many at a time; char may be signed: both end there */
        is_odd |= (at[byte] < ' ') | (at[byte] > '~');
    return !is_odd;
}

/* Say what a new text says. */
static int unescape(Text *text) {
    text->said = text->at, text->said_size = text->size;
    if (!is_printable(text->at, text->size)) return NOT_PLAIN;
    if (memchr(text->at, '\\', text->size) == NULL) return READ;
    char *said = malloc(text->size);
    int32_t size = 0;
    if (said == NULL) return NO_MEMORY;
    text->said = said;
    for (const char *at = text->at, *end = at + text->size; at < end; at++) {
        if (*at == '\\' && (++at == end || (*at != '"' && *at != '\\'))) return NOT_PLAIN;
        said[size++] = *at;
    }
    text->said_size = size;
    return READ;
}

/* Find the place of a text, which is new perhaps. */
static int place_of(Texts *all, const char *at, size_t size, int32_t *place) {
    uint32_t hash = hash_of(at, size), slot;
    if (all->count == all->room && grow_texts(all) == NO_MEMORY) return NO_MEMORY;
    slot = hash & all->mask;
    for (int probes = 0; all->slots[slot]; slot = (slot + 1) & all->mask) {
        const Text *text = all->texts + all->slots[slot] - 1;
        if (text->hash == hash && (size_t)text->size == size && !memcmp(text->at, at, size))
            return *place = all->slots[slot] - 1, READ;
        if (++probes > MAX_PROBES) return NOT_PLAIN;
    }
    *place = all->count++;
    all->texts[*place] = (Text){at, NULL, (int32_t)size, 0, hash};
    all->slots[slot] = *place + 1;
    return unescape(all->texts + *place);
}

/* Each of these reads something at *at, and goes on after it. */

static int read_text(Texts *all, const char **at, const char *end, int32_t *place) {
    if (*at == end || **at != '"') return NOT_PLAIN;
    const char *start = *at + 1, *stop = memchr(start, '"', end - start);
    if (stop != NULL && stop[-1] == '\\') /* escaped, perhaps */
        for (stop = start; stop < end && *stop != '"'; stop++) stop += *stop == '\\';
    if (stop == NULL || stop >= end) return NOT_PLAIN;
    *at = stop + 1;
    return place_of(all, start, stop - start, place);
}

static int read_integer(const char **at, const char *end, int64_t *found) {
    const char *digit = *at;
    int is_negative = digit < end && *digit == '-';
    const char *start = digit += is_negative;
    int64_t value = 0;
    for (; digit < end && *digit >= '0' && *digit <= '9'; digit++) {
        if (digit - start == MAX_DIGITS) return NOT_PLAIN;
        value = value * 10 + (*digit - '0');
    }
    if (digit == start || value > MAX_INTEGER) return NOT_PLAIN;
    if (*start == '0' && (is_negative || digit - start > 1)) return NOT_PLAIN;
    *at = digit, *found = is_negative ? -value : value;
    return READ;
}

static int read_word(const char **at, const char *end, const char *word, size_t size) {
    if ((size_t)(end - *at) < size || memcmp(*at, word, size)) return 0;
    *at += size;
    return 1;
}

static int read_list(Texts *all, Column *column, const char **at, const char *end) {
    if (*at == end || *(*at)++ != '[') return NOT_PLAIN;
    for (int is_first = 1;; is_first = 0) {
        if (*at < end && **at == ']' && is_first) return ++*at, READ;
        if (column->items == column->items_room) {
            size_t room = column->items_room * 2 + 256;
            int32_t *grown = realloc(column->places, room * sizeof *grown);
            if (grown == NULL) return NO_MEMORY;
            column->places = grown, column->items_room = room;
        }
        int how = read_text(all, at, end, column->places + column->items);
        if (how != READ) return how;
        column->items++;
        if (*at == end) return NOT_PLAIN;
        if (**at == ']') return ++*at, READ;
        if (*(*at)++ != ',') return NOT_PLAIN;
    }
}

/* Make room for the values of a column whose first one was met. */
static int begin(Column *column, int64_t rows) {
    size_t bits = (size_t)(rows + 7) / 8;
    column->is_there = calloc(bits, 1);
    if (column->is_there == NULL) return NO_MEMORY;
    if (column->kind == BOOLEAN) return (column->bits = calloc(bits, 1)) == NULL ? NO_MEMORY : READ;
    if (column->kind == INTEGER)
        return (column->integers = calloc((size_t)rows, sizeof *column->integers)) == NULL ? NO_MEMORY : READ;
    if (column->kind == STRINGS)
        return (column->ends = calloc((size_t)rows + 1, sizeof *column->ends)) == NULL ? NO_MEMORY : READ;
    column->places = malloc((size_t)rows * sizeof *column->places);
    if (column->places == NULL) return NO_MEMORY;
    memset(column->places, 0xff, (size_t)rows * sizeof *column->places); /* -1: none */
    return READ;
}

/* Say for the rows up to this one, which have no list beyond those so far, where their lists end. */
static void end_lists(Column *column, int64_t row) {
    while (column->ended < row) column->ends[++column->ended] = (int32_t)column->items;
}

static int read_value(Table *table, Column *column, int64_t row, const char **at, const char *end) {
    if (column->is_there == NULL && begin(column, table->rows) == NO_MEMORY) return NO_MEMORY;
    uint8_t bit = (uint8_t)(1 << (row & 7));
    column->is_there[row >> 3] |= bit;
    if (column->kind == STRING) return read_text(&table->texts, at, end, column->places + row);
    if (column->kind == INTEGER) return read_integer(at, end, column->integers + row);
    if (column->kind == BOOLEAN) {
        if (read_word(at, end, "false", 5)) return READ;
        if (!read_word(at, end, "true", 4)) return NOT_PLAIN;
        column->bits[row >> 3] |= bit;
        return READ;
    }
    end_lists(column, row);
    int how = read_list(&table->texts, column, at, end);
    if (how == READ) end_lists(column, row + 1);
    return how;
}

static uint32_t name_slot(const char *name, size_t size) { return hash_of(name, size) & (NAME_SLOTS - 1); }

static int column_named(const Table *table, const char *name, Py_ssize_t size) {
    for (uint32_t slot = name_slot(name, size); table->slots[slot]; slot = (slot + 1) & (NAME_SLOTS - 1)) {
        const Column *column = table->columns + table->slots[slot] - 1;
        if (column->name_size == size && !memcmp(column->name, name, size)) return table->slots[slot] - 1;
    }
    return -1;
}

static int read_row(Table *table, int64_t row, const char *at, const char *end) {
    int last = -1;
    for (char before = '{'; at < end && *at == before; before = ',') {
        if (++at == end || *at++ != '"') return NOT_PLAIN;
        const char *stop = memchr(at, '"', end - at);
        if (stop == NULL) return NOT_PLAIN;
        int found = column_named(table, at, stop - at);
        at = stop + 1;
        if (found <= last || at == end || *at++ != ':') return NOT_PLAIN;
        last = found;
        int how = read_value(table, table->columns + found, row, &at, end);
        if (how != READ) return how;
    }
    return last >= 0 && end - at == 1 && *at == '}' ? READ : NOT_PLAIN;
}

static int compare(const Text *one, const Text *other) {
    int32_t least = one->said_size < other->said_size ? one->said_size : other->said_size;
    int found = memcmp(one->said, other->said, least);
    return found ? found : one->said_size - other->said_size;
}

/* Sort these places by their texts, from the bottom up; `room` is as large. */
static int32_t *merge_sort(const Text *texts, int32_t *places, int32_t *room, int32_t count) {
    for (int64_t width = 1; width < count; width *= 2) {
        for (int64_t start = 0; start < count; start += 2 * width) {
            int64_t middle = start + width < count ? start + width : count;
            int64_t end = middle + width < count ? middle + width : count;
            int64_t left = start, right = middle;
            for (int64_t at = start; at < end; at++) {
                int is_left = left < middle && (right == end || compare(texts + places[left], texts + places[right]) <= 0);
                room[at] = is_left ? places[left++] : places[right++];
            }
        }
        int32_t *swapped = places;
        places = room, room = swapped;
    }
    return places;
}

/* Give a column of texts a sorted dictionary of its own: `ranks` are the places in order of all texts, `order` the reverse;
 * `codes` is room for one of each. */
static int give_dictionary(Column *column, const Texts *all, const int32_t *order, const int32_t *ranks, int32_t *codes,
                           int64_t rows) {
    size_t size = 0;
    int32_t used = 0, end = 0;
    memset(codes, 0, (size_t)all->count * sizeof *codes);
    for (int64_t row = 0; row < rows; row++)
        if (column->places[row] >= 0) codes[ranks[column->places[row]]] = 1;
    for (int32_t rank = 0; rank < all->count; rank++)
        if (codes[rank]) codes[rank] = used++, size += (size_t)all->texts[order[rank]].said_size;
        else codes[rank] = -1;
    column->words = malloc(size + 1), column->word_ends = malloc(((size_t)used + 1) * sizeof *column->word_ends);
    if (column->words == NULL || column->word_ends == NULL) return NO_MEMORY;
    column->words_count = used, column->word_ends[0] = 0;
    for (int32_t rank = 0; rank < all->count; rank++) {
        if (codes[rank] < 0) continue;
        const Text *text = all->texts + order[rank];
        memcpy(column->words + end, text->said, text->said_size);
        column->word_ends[codes[rank] + 1] = end += text->said_size;
    }
    for (int64_t row = 0; row < rows; row++)
        if (column->places[row] >= 0) column->places[row] = codes[ranks[column->places[row]]];
    return READ;
}

/* Write the texts of all lists of a column one after the other. */
static int give_words(Column *column, const Texts *all, int64_t rows) {
    size_t size = 0;
    int32_t end = 0;
    end_lists(column, rows);
    for (size_t item = 0; item < column->items; item++) size += (size_t)all->texts[column->places[item]].said_size;
    column->words = malloc(size + 1), column->word_ends = malloc((column->items + 1) * sizeof *column->word_ends);
    if (column->words == NULL || column->word_ends == NULL) return NO_MEMORY;
    column->words_count = (int32_t)column->items, column->word_ends[0] = 0;
    for (size_t item = 0; item < column->items; item++) {
        const Text *text = all->texts + column->places[item];
        memcpy(column->words + end, text->said, text->said_size);
        column->word_ends[item + 1] = end += text->said_size;
    }
    return READ;
}

static int give_words_to_all(Table *table) {
    size_t count = (size_t)table->texts.count + 1;
    int32_t *room = malloc(4 * count * sizeof *room);
    if (room == NULL) return NO_MEMORY;
    int32_t *order = room, *ranks = room + 2 * count, *codes = room + 3 * count;
    for (int32_t place = 0; place < table->texts.count; place++) order[place] = place;
    order = merge_sort(table->texts.texts, order, room + count, table->texts.count);
    for (int32_t rank = 0; rank < table->texts.count; rank++) ranks[order[rank]] = rank;
    int how = READ;
    for (Column *column = table->columns; how == READ && column < table->columns + table->count; column++) {
        if (column->is_there == NULL) continue;
        if (column->kind == STRING) how = give_dictionary(column, &table->texts, order, ranks, codes, table->rows);
        if (column->kind == STRINGS) how = give_words(column, &table->texts, table->rows);
    }
    free(room);
    return how;
}

static int take_rows(Table *table, const char *text, size_t size) {
    const char *end = text + size;
    for (const char *at = text; (at = memchr(at, '\n', end - at)) != NULL; at++) table->rows++;
    for (int64_t row = 0; row < table->rows; row++) {
        const char *stop = memchr(text, '\n', end - text);
        int how = read_row(table, row, text, stop);
        if (how != READ) return how;
        text = stop + 1;
    }
    return text == end ? give_words_to_all(table) : NOT_PLAIN;
}

/* Add a column (name, kind). Names are in order, and each is there once. */
static int add_column(Table *table, PyObject *given) {
    Column *column = table->columns + table->count;
    if (!PyArg_ParseTuple(given, "y#i", &column->name, &column->name_size, &column->kind)) return -1;
    uint32_t slot = name_slot(column->name, column->name_size);
    while (table->slots[slot]) slot = (slot + 1) & (NAME_SLOTS - 1);
    table->slots[slot] = (int16_t)++table->count;
    return 0;
}

static PyObject *bytes_of(const void *data, size_t size) { return PyBytes_FromStringAndSize(data, (Py_ssize_t)size); }

/* Return the column as a tuple of its arrays; None if no row has a value. */
static PyObject *made_of(const Column *column, int64_t rows) {
    size_t bits = (size_t)(rows + 7) / 8, ends = ((size_t)column->words_count + 1) * sizeof(int32_t);
    if (column->is_there == NULL) return Py_INCREF(Py_None), Py_None;
    PyObject *is_there = bytes_of(column->is_there, bits);
    if (column->kind == INTEGER) return Py_BuildValue("NN", is_there, bytes_of(column->integers, (size_t)rows * 8));
    if (column->kind == BOOLEAN) return Py_BuildValue("NN", is_there, bytes_of(column->bits, bits));
    PyObject *places = column->kind == STRING ? bytes_of(column->places, (size_t)rows * sizeof(int32_t))
                                              : bytes_of(column->ends, ((size_t)rows + 1) * sizeof(int32_t));
    return Py_BuildValue("NNNN", is_there, places, bytes_of(column->word_ends, ends),
                         bytes_of(column->words, (size_t)column->word_ends[column->words_count]));
}

static void release(Table *table) {
    for (const Text *text = table->texts.texts; text < table->texts.texts + table->texts.count; text++)
        if (text->said != text->at) free((void *)text->said);
    for (Column *column = table->columns; column < table->columns + table->count; column++) {
        free(column->is_there), free(column->bits), free(column->places), free(column->ends), free(column->integers);
        free(column->words), free(column->word_ends);
    }
    free(table->columns), free(table->texts.texts), free(table->texts.slots);
}

PyObject *read_rows(PyObject *module, PyObject *args) {
    PyObject *names, *made = NULL;
    const char *text;
    Py_ssize_t size;
    Table table = {0};
    int how;
    (void)module;
    if (!PyArg_ParseTuple(args, "y#O!", &text, &size, &PyTuple_Type, &names)) return NULL;
    if (PyTuple_Size(names) > MAX_NAMES) return PyErr_Format(PyExc_ValueError, "more than %d columns", MAX_NAMES);
    if (size > MAX_BYTES) return Py_INCREF(Py_None), Py_None;
    table.columns = calloc((size_t)PyTuple_Size(names) + 1, sizeof *table.columns);
    if (table.columns == NULL) return PyErr_NoMemory();
    for (Py_ssize_t at = 0; at < PyTuple_Size(names); at++)
        if (add_column(&table, PyTuple_GetItem(names, at)) < 0) return release(&table), NULL;
    Py_BEGIN_ALLOW_THREADS
    how = take_rows(&table, text, (size_t)size);
    Py_END_ALLOW_THREADS
    if (how == NO_MEMORY) PyErr_NoMemory();
    if (how == NOT_PLAIN) Py_INCREF(Py_None), made = Py_None;
    if (how == READ && (made = PyList_New(table.count)) != NULL)
        for (int at = 0; at < table.count; at++) {
            PyObject *column = made_of(table.columns + at, table.rows);
            if (column == NULL) {
                Py_CLEAR(made);
                break;
            }
            PyList_SetItem(made, at, column);
        }
    release(&table);
    return made;
}
