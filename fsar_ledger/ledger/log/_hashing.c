/* Hash many texts in one call: SHA-256 of FIPS 180-4; of rows and pairs of hashes with a byte before, as in RFC 6962.
 *
 * `hashing.py` does the same with hashlib, for machines without a compiler; tests require both to agree. Each call
 * lets other threads of Python run. On x86 with the SHA extensions, one block takes some 50 ns, else some 250.
 */

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define HASH_BYTES 32
#define PAIR_BYTES (2 * HASH_BYTES)
#define BLOCK_BYTES 64
#define MAX_SUBTREES 64

static const uint32_t CONSTANTS[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
};

static const uint32_t START[8] = {
    0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19,
};

static uint32_t load(const uint8_t *at) {
    return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

static void store(uint8_t *at, uint32_t word) {
    at[0] = (uint8_t)(word >> 24), at[1] = (uint8_t)(word >> 16), at[2] = (uint8_t)(word >> 8), at[3] = (uint8_t)word;
}

static uint32_t rotated(uint32_t word, int bits) { return word >> bits | word << (32 - bits); }

static void compress_plainly(uint32_t state[8], const uint8_t *block, size_t blocks) {
    for (; blocks; blocks--, block += BLOCK_BYTES) {
        uint32_t w[64], s[8];
        for (int i = 0; i < 16; i++) w[i] = load(block + 4 * i);
        for (int i = 16; i < 64; i++) {
            uint32_t a = w[i - 15], b = w[i - 2];
            w[i] = w[i - 16] + w[i - 7] + (rotated(a, 7) ^ rotated(a, 18) ^ a >> 3) +
                   (rotated(b, 17) ^ rotated(b, 19) ^ b >> 10);
        }
        memcpy(s, state, sizeof s);
        for (int i = 0; i < 64; i++) {
            uint32_t e = s[4], a = s[0];
            uint32_t one = s[7] + (rotated(e, 6) ^ rotated(e, 11) ^ rotated(e, 25)) + ((e & s[5]) ^ (~e & s[6])) +
                           CONSTANTS[i] + w[i];
            uint32_t two = (rotated(a, 2) ^ rotated(a, 13) ^ rotated(a, 22)) +
                           ((a & s[1]) ^ (a & s[2]) ^ (s[1] & s[2]));
            memmove(s + 1, s, 7 * sizeof *s);
            s[4] += one, s[0] = one + two;
        }
        for (int i = 0; i < 8; i++) state[i] += s[i];
    }
}

#if (defined(__x86_64__) || defined(__i386__)) && (defined(__GNUC__) || defined(__clang__))
#define HAS_SHA_EXTENSIONS 1
#include <cpuid.h>
#include <immintrin.h>

#define WITH_EXTENSIONS __attribute__((target("sha,sse4.1")))
#define STEPS 16 /* each of 4 rounds: the instructions do two at a time */

/* A hash as the instructions take it, and the words of the schedule that are needed next. */
typedef struct {
    __m128i abef, cdgh, w[4];
} Lane;

WITH_EXTENSIONS static inline Lane lane_of(const uint32_t state[8]) {
    __m128i low = _mm_shuffle_epi32(_mm_loadu_si128((const __m128i *)state), 0xb1);
    __m128i high = _mm_shuffle_epi32(_mm_loadu_si128((const __m128i *)(state + 4)), 0x1b);
    Lane lane = {.abef = _mm_alignr_epi8(low, high, 8), .cdgh = _mm_blend_epi16(high, low, 0xf0)};
    return lane;
}

WITH_EXTENSIONS static inline void keep(const Lane *lane, uint32_t state[8]) {
    __m128i low = _mm_shuffle_epi32(lane->abef, 0x1b), high = _mm_shuffle_epi32(lane->cdgh, 0xb1);
    _mm_storeu_si128((__m128i *)state, _mm_blend_epi16(low, high, 0xf0));
    _mm_storeu_si128((__m128i *)(state + 4), _mm_alignr_epi8(high, low, 8));
}

WITH_EXTENSIONS static inline void four_rounds(Lane *lane, __m128i words, int step) {
    words = _mm_add_epi32(words, _mm_loadu_si128((const __m128i *)(CONSTANTS + 4 * step)));
    lane->cdgh = _mm_sha256rnds2_epu32(lane->cdgh, lane->abef, words);
    lane->abef = _mm_sha256rnds2_epu32(lane->abef, lane->cdgh, _mm_shuffle_epi32(words, 0x0e));
}

/* The words of one of the first four steps are those of the block. */
WITH_EXTENSIONS static inline void begin_with(Lane *lane, int step, const uint8_t *block) {
    const __m128i order = _mm_set_epi64x(0x0c0d0e0f08090a0bULL, 0x0405060700010203ULL);
    lane->w[step] = _mm_shuffle_epi8(_mm_loadu_si128((const __m128i *)(block + 16 * step)), order);
    four_rounds(lane, lane->w[step], step);
}

/* Those of the others follow from the four steps before, of which the oldest is in this place. */
WITH_EXTENSIONS static inline void go_on(Lane *lane, int step, int place) {
    __m128i *w = lane->w, words = _mm_sha256msg1_epu32(w[place], w[(place + 1) % 4]);
    words = _mm_add_epi32(words, _mm_alignr_epi8(w[(place + 3) % 4], w[(place + 2) % 4], 4));
    w[place] = _mm_sha256msg2_epu32(words, w[(place + 3) % 4]);
    four_rounds(lane, w[place], step + place);
}

WITH_EXTENSIONS static inline void add_state(Lane *lane, const Lane *before) {
    lane->abef = _mm_add_epi32(lane->abef, before->abef), lane->cdgh = _mm_add_epi32(lane->cdgh, before->cdgh);
}

WITH_EXTENSIONS static void compress_with_extensions(uint32_t state[8], const uint8_t *block, size_t blocks) {
    Lane lane = lane_of(state);
    for (; blocks; blocks--, block += BLOCK_BYTES) {
        Lane before = lane;
        begin_with(&lane, 0, block), begin_with(&lane, 1, block), begin_with(&lane, 2, block), begin_with(&lane, 3, block);
        for (int i = 4; i < STEPS; i += 4) go_on(&lane, i, 0), go_on(&lane, i, 1), go_on(&lane, i, 2), go_on(&lane, i, 3);
        add_state(&lane, &before);
    }
    keep(&lane, state);
}

/* Each step waits for the one before, so two hashes at a time take little longer than one. */
WITH_EXTENSIONS static void compress_two_with_extensions(uint32_t state[8], const uint8_t *block, uint32_t other_state[8],
                                                         const uint8_t *other_block, size_t blocks) {
    Lane lane = lane_of(state), other = lane_of(other_state);
    for (; blocks; blocks--, block += BLOCK_BYTES, other_block += BLOCK_BYTES) {
        Lane before = lane, other_before = other;
        begin_with(&lane, 0, block), begin_with(&other, 0, other_block);
        begin_with(&lane, 1, block), begin_with(&other, 1, other_block);
        begin_with(&lane, 2, block), begin_with(&other, 2, other_block);
        begin_with(&lane, 3, block), begin_with(&other, 3, other_block);
        for (int i = 4; i < STEPS; i += 4) {
            go_on(&lane, i, 0), go_on(&other, i, 0), go_on(&lane, i, 1), go_on(&other, i, 1);
            go_on(&lane, i, 2), go_on(&other, i, 2), go_on(&lane, i, 3), go_on(&other, i, 3);
        }
        add_state(&lane, &before), add_state(&other, &other_before);
    }
    keep(&lane, state), keep(&other, other_state);
}

static int has_sha_extensions(void) {
    unsigned a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_SSE4_1)) return 0;
    return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_SHA);
}
#endif

static void compress_two_plainly(uint32_t state[8], const uint8_t *block, uint32_t other_state[8],
                                 const uint8_t *other_block, size_t blocks) {
    compress_plainly(state, block, blocks), compress_plainly(other_state, other_block, blocks);
}

static void (*compress)(uint32_t state[8], const uint8_t *block, size_t blocks) = compress_plainly;
static void (*compress_two)(uint32_t state[8], const uint8_t *block, uint32_t other_state[8], const uint8_t *other_block,
                            size_t blocks) = compress_two_plainly;

#define NOTHING (-1)

/* Write SHA-256(first || data) to `out`; `first` is a byte or NOTHING. */
static void hash_after(int first, const uint8_t *data, size_t size, uint8_t *out) {
    uint32_t state[8];
    uint8_t block[2 * BLOCK_BYTES];
    size_t before = first != NOTHING;
    uint64_t bits = (uint64_t)(size + before) * 8;
    memcpy(state, START, sizeof state);
    block[0] = (uint8_t)first;
    size_t taken = size < BLOCK_BYTES - before ? size : BLOCK_BYTES - before;
    memcpy(block + before, data, taken);
    size_t filled = taken + before;
    if (filled == BLOCK_BYTES) {
        compress(state, block, 1);
        size_t whole = (size - taken) / BLOCK_BYTES;
        compress(state, data + taken, whole);
        taken += whole * BLOCK_BYTES;
        filled = size - taken;
        memcpy(block, data + taken, filled);
    }
    block[filled++] = 0x80;
    size_t end = filled + 8 <= BLOCK_BYTES ? BLOCK_BYTES : 2 * BLOCK_BYTES;
    memset(block + filled, 0, end - filled);
    for (int i = 0; i < 8; i++) block[end - 1 - i] = (uint8_t)(bits >> 8 * i);
    compress(state, block, end / BLOCK_BYTES);
    for (int i = 0; i < 8; i++) store(out + 4 * i, state[i]);
}

#define SHORT_BYTES 4000 /* most rows and records are shorter */
#define PADDED_BYTES ((SHORT_BYTES + 9) / BLOCK_BYTES * BLOCK_BYTES + BLOCK_BYTES)

/* Put first || data, which is short, into whole blocks as they are hashed; return how many. */
static size_t pad(int first, const uint8_t *data, size_t size, uint8_t *padded) {
    size_t before = first != NOTHING, blocks = (size + before + 9 + BLOCK_BYTES - 1) / BLOCK_BYTES;
    size_t end = blocks * BLOCK_BYTES;
    uint64_t bits = (uint64_t)(size + before) * 8;
    memset(padded + end - BLOCK_BYTES, 0, BLOCK_BYTES);
    if (blocks > 1) memset(padded + end - 2 * BLOCK_BYTES, 0, BLOCK_BYTES);
    padded[0] = (uint8_t)first;
    memcpy(padded + before, data, size);
    padded[size + before] = 0x80;
    for (int i = 0; i < 8; i++) padded[end - 1 - i] = (uint8_t)(bits >> 8 * i);
    return blocks;
}

/* Write SHA-256(first || data) of two texts; `first` is a byte or NOTHING. */
static void hash_two(int first, const uint8_t *data, size_t size, uint8_t *out, const uint8_t *other, size_t other_size,
                     uint8_t *other_out) {
    uint8_t padded[PADDED_BYTES], other_padded[PADDED_BYTES];
    uint32_t state[8], other_state[8];
    if (size >= SHORT_BYTES || other_size >= SHORT_BYTES) {
        hash_after(first, data, size, out), hash_after(first, other, other_size, other_out);
        return;
    }
    size_t blocks = pad(first, data, size, padded), other_blocks = pad(first, other, other_size, other_padded);
    size_t both = blocks < other_blocks ? blocks : other_blocks, done = both * BLOCK_BYTES;
    memcpy(state, START, sizeof state), memcpy(other_state, START, sizeof other_state);
    compress_two(state, padded, other_state, other_padded, both);
    compress(state, padded + done, blocks - both), compress(other_state, other_padded + done, other_blocks - both);
    for (int i = 0; i < 8; i++) store(out + 4 * i, state[i]), store(other_out + 4 * i, other_state[i]);
}

/* Return how many lines these are. Raises: ValueError (-1) if the last one does not end. */
static Py_ssize_t count_lines(const char *data, Py_ssize_t size) {
    Py_ssize_t rows = 0;
    if (size && data[size - 1] != '\n') return PyErr_Format(PyExc_ValueError, "the last line does not end"), -1;
    for (const char *at = data; (at = memchr(at, '\n', data + size - at)) != NULL; at++) rows++;
    return rows;
}

/* Write the leaf hashes of these lines, each ended by a line feed. */
static void hash_lines(const char *data, Py_ssize_t size, uint8_t *hashes) {
    const char *before = NULL, *at = data;
    Py_ssize_t before_size = 0;
    for (; at < data + size; hashes += HASH_BYTES) {
        const char *end = memchr(at, '\n', data + size - at);
        if (before == NULL) {
            before = at, before_size = end - at;
        } else {
            hash_two(0x00, (const uint8_t *)before, before_size, hashes - HASH_BYTES, (const uint8_t *)at, end - at, hashes);
            before = NULL;
        }
        at = end + 1;
    }
    if (before != NULL) hash_after(0x00, (const uint8_t *)before, before_size, hashes - HASH_BYTES);
}

static PyObject *leaves(PyObject *module, PyObject *lines) {
    char *data, *hashes;
    Py_ssize_t size, rows;
    (void)module;
    if (PyBytes_AsStringAndSize(lines, &data, &size) < 0 || (rows = count_lines(data, size)) < 0) return NULL;
    PyObject *found = PyBytes_FromStringAndSize(NULL, rows * HASH_BYTES);
    if (found == NULL) return NULL;
    hashes = PyBytes_AsString(found);
    Py_BEGIN_ALLOW_THREADS
    hash_lines(data, size, (uint8_t *)hashes);
    Py_END_ALLOW_THREADS
    return found;
}

static PyObject *digests(PyObject *module, PyObject *texts) {
    (void)module;
    if (!PyList_Check(texts)) return PyErr_Format(PyExc_TypeError, "found no list, expected one of bytes");
    PyObject *found = PyBytes_FromStringAndSize(NULL, PyList_Size(texts) * HASH_BYTES);
    if (found == NULL) return NULL;
    uint8_t *hash = (uint8_t *)PyBytes_AsString(found);
    char *data, *before = NULL;
    Py_ssize_t size, before_size = 0;
    for (Py_ssize_t at = 0; at < PyList_Size(texts); at++, before_size = size, hash += HASH_BYTES) {
        if (PyBytes_AsStringAndSize(PyList_GetItem(texts, at), &data, &size) < 0) return Py_DECREF(found), NULL;
        if (at % 2)
            hash_two(NOTHING, (const uint8_t *)before, before_size, hash - HASH_BYTES, (const uint8_t *)data, size, hash);
        before = data;
    }
    if (PyList_Size(texts) % 2) hash_after(NOTHING, (const uint8_t *)before, before_size, hash - HASH_BYTES);
    return found;
}

/* Write the parents of pairs of nodes; they may be where the nodes are. */
static void hash_pairs(const uint8_t *nodes, size_t pairs, uint8_t *parents) {
    for (; pairs >= 2; pairs -= 2, nodes += 2 * PAIR_BYTES, parents += 2 * HASH_BYTES)
        hash_two(0x01, nodes, PAIR_BYTES, parents, nodes + PAIR_BYTES, PAIR_BYTES, parents + HASH_BYTES);
    if (pairs) hash_after(0x01, nodes, PAIR_BYTES, parents);
}

static PyObject *parents(PyObject *module, PyObject *nodes) {
    char *data, *hashes;
    Py_ssize_t size;
    (void)module;
    if (PyBytes_AsStringAndSize(nodes, &data, &size) < 0) return NULL;
    if (size % PAIR_BYTES) return PyErr_Format(PyExc_ValueError, "found %zd bytes, expected pairs of hashes", size);
    PyObject *found = PyBytes_FromStringAndSize(NULL, size / 2);
    if (found == NULL) return NULL;
    hashes = PyBytes_AsString(found);
    Py_BEGIN_ALLOW_THREADS
    hash_pairs((const uint8_t *)data, size / PAIR_BYTES, (uint8_t *)hashes);
    Py_END_ALLOW_THREADS
    return found;
}

/* Write the root of a tree with these complete subtrees, largest first; at least one. */
static void fold(const uint8_t (*subtrees)[HASH_BYTES], int count, uint8_t *root) {
    uint8_t pair[PAIR_BYTES];
    memcpy(root, subtrees[count - 1], HASH_BYTES);
    for (int at = count - 2; at >= 0; at--) {
        memcpy(pair, subtrees[at], HASH_BYTES), memcpy(pair + HASH_BYTES, root, HASH_BYTES);
        hash_after(0x01, pair, sizeof pair, root);
    }
}

/* A tree as its complete subtrees, largest first: one for each bit of its size. */
typedef struct {
    unsigned long long size;
    int count;
    uint8_t kept[MAX_SUBTREES][HASH_BYTES];
} Tree;

/* Begin with so many leaves and these packed subtrees. Raises: ValueError if they do not fit. */
static int begin(Tree *tree, unsigned long long size, const char *subtrees, Py_ssize_t subtrees_size, Py_ssize_t leaves_size) {
    tree->size = size, tree->count = 0;
    for (unsigned long long rest = size; rest; rest &= rest - 1) tree->count++;
    if (subtrees_size != tree->count * HASH_BYTES || leaves_size % HASH_BYTES || size >> 62) {
        PyErr_Format(PyExc_ValueError, "found subtrees or leaves that are not those of a tree");
        return -1;
    }
    memcpy(tree->kept, subtrees, subtrees_size);
    return 0;
}

static void add_leaf(Tree *tree, const uint8_t *leaf) {
    uint8_t pair[PAIR_BYTES], *hash = tree->kept[tree->count++];
    memcpy(hash, leaf, HASH_BYTES);
    for (unsigned long long rest = tree->size++; rest & 1; rest >>= 1, tree->count--) {
        hash = tree->kept[tree->count - 2];
        memcpy(pair, hash, sizeof pair);
        hash_after(0x01, pair, sizeof pair, hash);
    }
}

#define FEW_LEAVES 4

/* Add packed leaves, level by level if they are many. */
static void add_leaves(Tree *tree, const uint8_t *leaves, size_t count) {
    uint8_t *work = count < FEW_LEAVES ? NULL : malloc((count + 1) * HASH_BYTES), made[MAX_SUBTREES][HASH_BYTES];
    if (work == NULL) {
        for (; count; count--, leaves += HASH_BYTES) add_leaf(tree, leaves);
        return;
    }
    int found = 0; /* subtrees that are complete now, smallest first */
    unsigned long long size = tree->size;
    tree->size += count;
    memcpy(work + HASH_BYTES, leaves, count * HASH_BYTES);
    for (; count; size >>= 1, count /= 2) {
        uint8_t *nodes = work + HASH_BYTES;
        if (size & 1) nodes = work, count++, memcpy(nodes, tree->kept[--tree->count], HASH_BYTES);
        if (count & 1) memcpy(made[found++], nodes + (count - 1) * HASH_BYTES, HASH_BYTES);
        hash_pairs(nodes, count / 2, work + HASH_BYTES);
    }
    while (found) memcpy(tree->kept[tree->count++], made[--found], HASH_BYTES);
    free(work);
}

static PyObject *extended(PyObject *module, PyObject *args) {
    const char *before, *leaves;
    Py_ssize_t before_size, leaves_size;
    unsigned long long size;
    Tree tree;
    (void)module;
    if (!PyArg_ParseTuple(args, "Ky#y#", &size, &before, &before_size, &leaves, &leaves_size)) return NULL;
    if (begin(&tree, size, before, before_size, leaves_size) < 0) return NULL;
    Py_BEGIN_ALLOW_THREADS
    add_leaves(&tree, (const uint8_t *)leaves, leaves_size / HASH_BYTES);
    Py_END_ALLOW_THREADS
    return PyBytes_FromStringAndSize((const char *)tree.kept, (Py_ssize_t)tree.count * HASH_BYTES);
}

static PyObject *roots(PyObject *module, PyObject *args) {
    const char *before, *leaves;
    Py_ssize_t before_size, leaves_size;
    unsigned long long size;
    Tree tree;
    PyObject *sizes;
    (void)module;
    if (!PyArg_ParseTuple(args, "Ky#y#O!", &size, &before, &before_size, &leaves, &leaves_size, &PyList_Type, &sizes))
        return NULL;
    if (begin(&tree, size, before, before_size, leaves_size) < 0) return NULL;
    PyObject *found = PyBytes_FromStringAndSize(NULL, PyList_Size(sizes) * HASH_BYTES);
    if (found == NULL) return NULL;
    uint8_t *root = (uint8_t *)PyBytes_AsString(found);
    const uint8_t *leaf = (const uint8_t *)leaves, *end = leaf + leaves_size;
    for (Py_ssize_t at = 0; at < PyList_Size(sizes); at++, root += HASH_BYTES) {
        unsigned long long wanted = PyLong_AsUnsignedLongLong(PyList_GetItem(sizes, at));
        if (PyErr_Occurred()) return Py_DECREF(found), NULL;
        if (wanted < tree.size || !wanted || wanted - tree.size > (unsigned long long)(end - leaf) / HASH_BYTES)
            return Py_DECREF(found), PyErr_Format(PyExc_ValueError, "found size %llu, expected more, and leaves for it", wanted);
        size_t more = wanted - tree.size;
        add_leaves(&tree, leaf, more);
        leaf += more * HASH_BYTES;
        fold((const uint8_t(*)[HASH_BYTES])tree.kept, tree.count, root);
    }
    return found;
}

/* Few rows are hashed before another thread would have begun. */
#define FEW_BYTES (1 << 14)

static PyObject *added(PyObject *module, PyObject *args) {
    const char *before, *data;
    Py_ssize_t before_size, size, rows;
    unsigned long long leaves;
    uint8_t root[HASH_BYTES];
    Tree tree;
    (void)module;
    if (!PyArg_ParseTuple(args, "Ky#y#", &leaves, &before, &before_size, &data, &size)) return NULL;
    if (begin(&tree, leaves, before, before_size, 0) < 0 || (rows = count_lines(data, size)) < 0) return NULL;
    if (!rows) return PyErr_Format(PyExc_ValueError, "found no lines, expected at least one");
    PyObject *found = PyBytes_FromStringAndSize(NULL, rows * HASH_BYTES);
    if (found == NULL) return NULL;
    uint8_t *hashes = (uint8_t *)PyBytes_AsString(found);
    PyThreadState *others = size > FEW_BYTES ? PyEval_SaveThread() : NULL;
    hash_lines(data, size, hashes);
    add_leaves(&tree, hashes, rows);
    fold((const uint8_t(*)[HASH_BYTES])tree.kept, tree.count, root);
    if (others != NULL) PyEval_RestoreThread(others);
    return Py_BuildValue("(Ny#y#)", found, tree.kept, (Py_ssize_t)tree.count * HASH_BYTES, root, (Py_ssize_t)HASH_BYTES);
}

static PyMethodDef METHODS[] = {
    {"leaves", leaves, METH_O, "Return the packed leaf hashes of these lines, each ended by a line feed."},
    {"digests", digests, METH_O, "Return the packed hashes of these texts."},
    {"parents", parents, METH_O, "Return the packed hashes of pairs of packed hashes."},
    {"extended", extended, METH_VARARGS, "Return the packed subtrees of a tree after these packed leaves are added."},
    {"added", added, METH_VARARGS, "Return the packed leaf hashes of lines, and the packed subtrees and the root of a tree after them."},
    {"roots", roots, METH_VARARGS, "Return the packed roots of a tree when it has so many leaves."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_hashing", NULL, 0, METHODS, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__hashing(void) {
#ifdef HAS_SHA_EXTENSIONS
    if (has_sha_extensions()) compress = compress_with_extensions, compress_two = compress_two_with_extensions;
#endif
    return PyModule_Create(&MODULE);
}
