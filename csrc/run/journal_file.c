/* The file of a journal: what stands where in it, and what in it is whole. */
#define _DEFAULT_SOURCE
#define _FILE_OFFSET_BITS 64
#include "run/journal.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

enum { VERSION = 3, BYTE_ORDER_MARK = 0x01020304, BLOCK = 1 << 16 };

static const char MAGIC[8] = "dalrun\r\n"; /* which a transfer as text would change */

static int fail_io(dal_error *error, const char *path, const char *what)
{
    const int code = errno;
    return dal__fail(error, DAL_EIO, "%s: %s: %s", path, what, strerror(code));
}

/* ---- checksums ----------------------------------------------------------------------------- */

/* CRC-32C (Castagnoli, 0x1edc6f41, reflected), by tables for eight bytes at a time. */
static void fill_tables(uint32_t table[8][256])
{
    for (uint32_t byte = 0; byte < 256; byte++) {
        uint32_t c = byte;
        for (int bit = 0; bit < 8; bit++) c = c & 1 ? c >> 1 ^ UINT32_C(0x82f63b78) : c >> 1;
        table[0][byte] = c;
    }
    for (int k = 1; k < 8; k++)
        for (uint32_t byte = 0; byte < 256; byte++)
            table[k][byte] = table[k - 1][byte] >> 8 ^ table[0][table[k - 1][byte] & 255];
}

static uint32_t checksum(const dal_journal *self, uint32_t start, const void *bytes, size_t size)
{
    const unsigned char *p = bytes;
    uint32_t c = ~start;
    for (; size >= 8; size -= 8, p += 8) {
        const uint32_t low = c ^ (p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16
                                  | (uint32_t)p[3] << 24);
        c = self->table[7][low & 255] ^ self->table[6][low >> 8 & 255]
          ^ self->table[5][low >> 16 & 255] ^ self->table[4][low >> 24] ^ self->table[3][p[4]]
          ^ self->table[2][p[5]] ^ self->table[1][p[6]] ^ self->table[0][p[7]];
    }
    for (; size > 0; size--, p++) c = c >> 8 ^ self->table[0][(c ^ *p) & 255];
    return ~c;
}

static uint32_t of_head(const dal_journal *self)
{
    dal__head head = self->head;
    head.checksum = 0;
    return checksum(self, checksum(self, 0, &head, sizeof head), self->description,
                    (size_t)head.description_size);
}

/* Of a part of the file, which begins with its checksum. */
static uint32_t of_part(const dal_journal *self, size_t where, const void *bytes, size_t size)
{
    const uint64_t place = where;
    const uint32_t start = checksum(self, self->head.checksum, &place, sizeof place);
    return checksum(self, start, (const char *)bytes + sizeof start, size - sizeof start);
}

static bool is_whole(const dal_journal *self, size_t where, const void *bytes, size_t size)
{
    uint32_t stored;
    memcpy(&stored, bytes, sizeof stored);
    return stored == of_part(self, where, bytes, size);
}

/* ---- reading and writing ------------------------------------------------------------------- */

static int write_at(const dal_journal *self, size_t where, const void *bytes, size_t size,
                    dal_error *error)
{
    const char *p = bytes;
    while (size > 0) {
        const ssize_t made = pwrite(self->file, p, size, (off_t)where);
        if (made < 0 && errno == EINTR) continue;
        if (made < 0) return fail_io(error, self->path, "writing");
        p += made;
        where += (size_t)made;
        size -= (size_t)made;
    }
    return DAL_SUCCESS;
}

/* *found <- how many bytes there were, up to size. */
static int read_at(int file, const char *path, size_t where, void *bytes, size_t size,
                   size_t *found, dal_error *error)
{
    *found = 0;
    while (*found < size) {
        const ssize_t got =
            pread(file, (char *)bytes + *found, size - *found, (off_t)(where + *found));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return fail_io(error, path, "reading");
        if (got == 0) break;
        *found += (size_t)got;
    }
    return DAL_SUCCESS;
}

/* ---- the object ---------------------------------------------------------------------------- */

static size_t doubles(size_t count) { return dal__times(count, sizeof(double)); }

/* a + b, or more than there is memory. */
static size_t plus(size_t a, size_t b)
{
    const size_t most = SIZE_MAX / 4;
    return a > most || b > most ? most : a + b;
}

int dal__journal_allocate(dal_journal **journal, const char *path, const dal__head *head,
                          const void *description, dal_error *error)
{
    dal_journal shape = {.head = *head, .file = -1}, *self;
    const size_t described = (size_t)head->description_size, named = strlen(path) + 1;
    const size_t input = dal__times((size_t)head->input_rows, (size_t)head->inputs);
    const size_t numbers = plus(plus(1, dal__times(2, (size_t)head->n)),
                                plus((size_t)head->m, input));
    shape.size = plus(sizeof(dal__tag), doubles(numbers));
    shape.slot_size = plus(sizeof(dal__mark), doubles((size_t)head->snapshot));
    shape.description_at = sizeof *head;
    shape.writer_at = plus(shape.description_at, plus(described, 7) / 8 * 8);
    shape.slots_at = shape.writer_at + DAL__WRITER;
    shape.begin = plus(shape.slots_at, dal__times(DAL__SLOTS, shape.slot_size));
    shape.capacity = shape.size < BLOCK ? BLOCK / shape.size : 1;
    arena a = {0};
    dal__reserve(&a, &self, 1, sizeof *self);
    dal__reserve(&a, &shape.path, named, 1);
    dal__reserve(&a, &shape.description, plus(described, 1), 1);
    dal__reserve(&a, &shape.writer, DAL__WRITER + 1, 1);
    dal__reserve(&a, &shape.slot, shape.slot_size, 1);
    dal__reserve(&a, &shape.line, shape.size, 1);
    dal__reserve(&a, &shape.block, shape.capacity, shape.size);
    DAL__RESERVE(&a, (size_t)head->snapshot, &shape.snapshot);
    DAL__RESERVE(&a, (size_t)head->m, &shape.reaction);
    const int status = dal__allocate(&a, error);
    if (status) return status;
    *self = shape;
    self->arena = a;
    memcpy(self->path, path, named);
    if (described > 0 && description) memcpy(self->description, description, described);
    fill_tables(self->table);
    *journal = self;
    return DAL_SUCCESS;
}

void dal__journal_detach(dal_journal *self)
{
    if (self->file >= 0) close(self->file);
    dal__release(&self->arena);
}

/* Who writes, for others to read. */
static int sign(dal_journal *self, dal_error *error)
{
    char host[64] = "";
    gethostname(host, sizeof host - 1);
    memset(self->writer, 0, DAL__WRITER);
    snprintf(self->writer, DAL__WRITER, "process %ld on %s", (long)getpid(), host);
    return write_at(self, self->writer_at, self->writer, DAL__WRITER, error);
}

/* ---- slots --------------------------------------------------------------------------------- */

static size_t slot_at(const dal_journal *self, uint32_t serial)
{
    return self->slots_at + (serial == 0 ? 0 : 1 + serial % 2) * self->slot_size;
}

static int write_slot(dal_journal *self, dal_error *error)
{
    const size_t where = slot_at(self, self->mark.serial);
    memcpy(self->slot, &self->mark, sizeof self->mark);
    memcpy(self->slot + sizeof self->mark, self->snapshot, doubles((size_t)self->head.snapshot));
    self->mark.checksum = of_part(self, where, self->slot, self->slot_size);
    memcpy(self->slot, &self->mark.checksum, sizeof self->mark.checksum);
    return write_at(self, where, self->slot, self->slot_size, error);
}

int dal__journal_recall(dal_journal *self)
{
    bool any = false;
    for (uint32_t k = 0; k < DAL__SLOTS; k++) {
        const size_t where = slot_at(self, k);
        size_t found;
        dal__mark mark;
        const int status = read_at(self->file, self->path, where, self->slot, self->slot_size,
                                   &found, &self->error);
        if (status) return status;
        memcpy(&mark, self->slot, sizeof mark);
        if (found < self->slot_size || !is_whole(self, where, self->slot, self->slot_size)
            || mark.records > self->records || (any && mark.serial < self->mark.serial))
            continue;
        any = true;
        self->mark = mark;
        memcpy(self->snapshot, self->slot + sizeof mark, doubles((size_t)self->head.snapshot));
    }
    if (any) return DAL_SUCCESS;
    return dal__fail(&self->error, DAL_EUNSUPPORTED, "%s: no snapshot is complete, so the run "
                     "cannot be resumed", self->path);
}

/* ---- opening ------------------------------------------------------------------------------- */

/* The entry of a directory, to the disk; where that cannot be, it is not. */
static void sync_directory(const char *path, char *scratch)
{
    const char *const slash = strrchr(path, '/');
    const size_t length = slash ? (size_t)(slash - path) + 1 : 0;
    memcpy(scratch, path, length);
    strcpy(scratch + length, ".");
    const int folder = open(scratch, O_RDONLY | O_CLOEXEC);
    if (folder < 0) return;
    fsync(folder);
    close(folder);
}

/* The complete file under its name, unless there is one. */
static int publish(dal_journal *self, const char *hidden, dal_error *error)
{
    int status = link(hidden, self->path);
    if (status && errno != EEXIST && access(self->path, F_OK) != 0)
        return rename(hidden, self->path) ? fail_io(error, self->path, "renaming") : DAL_SUCCESS;
    if (status)
        status = dal__fail(error, DAL_EINVAL, "%s: the file exists already; resume its run, or "
                           "remove it", self->path);
    unlink(hidden);
    return status;
}

/* Whether the file is locked, or cannot be: some file systems of clusters have no locks. */
static bool take_lock(const dal_journal *self, int kind)
{
    return flock(self->file, kind | LOCK_NB) == 0 || errno == ENOSYS || errno == ENOTSUP
        || errno == ENOLCK;
}

static int fill_new(dal_journal *self, dal_error *error)
{
    int status = DAL_SUCCESS;
    if (!take_lock(self, LOCK_EX)) status = fail_io(error, self->path, "locking");
    self->head.checksum = of_head(self);
    if (!status) status = write_at(self, 0, &self->head, sizeof self->head, error);
    if (!status)
        status = write_at(self, self->description_at, self->description,
                          (size_t)self->head.description_size, error);
    if (!status) status = sign(self, error);
    if (!status && ftruncate(self->file, (off_t)self->begin))
        status = fail_io(error, self->path, "writing");
    if (!status) status = write_slot(self, error);
    if (!status && fsync(self->file)) status = fail_io(error, self->path, "writing");
    return status;
}

int dal__journal_create(dal_journal *self, dal_error *error)
{
    char *const hidden = (char *)self->block; /* no shorter than a path that can be opened */
    if (strlen(self->path) + 40 > self->capacity * self->size)
        return dal__fail(error, DAL_EINVAL, "path has %zu characters, which is too long",
                         strlen(self->path));
    memcpy(self->head.magic, MAGIC, sizeof MAGIC);
    self->head.order = BYTE_ORDER_MARK;
    self->head.version = VERSION;
    self->head.made = dal__clock();
    self->writes = true;
    self->saved_at = self->head.made;
    sprintf(hidden, "%s.%ld.new", self->path, (long)getpid());
    self->file = open(hidden, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (self->file < 0) return fail_io(error, self->path, "creating");
    int status = fill_new(self, error);
    if (status) unlink(hidden);
    else status = publish(self, hidden, error);
    if (!status) sync_directory(self->path, hidden);
    return status;
}

/* The head, and how long the file is. */
static int read_head(int file, const char *path, dal__head *head, size_t *length, dal_error *error)
{
    struct stat now;
    size_t found;
    if (fstat(file, &now)) return fail_io(error, path, "reading");
    *length = (size_t)now.st_size;
    const int status = read_at(file, path, 0, head, sizeof *head, &found, error);
    if (status) return status;
    if (found < sizeof *head || memcmp(head->magic, MAGIC, sizeof MAGIC) != 0)
        return dal__fail(error, DAL_EINVAL, "%s: not the journal of a run", path);
    if (head->order != BYTE_ORDER_MARK)
        return dal__fail(error, DAL_EINVAL, "%s: written on a machine with another byte order, or "
                         "the header is damaged", path);
    if (head->version != VERSION)
        return dal__fail(error, DAL_EINVAL, "%s: written in version %u of the format, expected "
                         "version %d, or the header is damaged", path, (unsigned)head->version,
                         VERSION);
    if (head->description_size > *length || head->n > *length || head->m > *length
        || head->snapshot > *length || head->input_rows > *length || head->inputs > *length)
        return dal__fail(error, DAL_EINVAL, "%s: the header is damaged", path);
    return DAL_SUCCESS;
}

/* Records that are whole, one after the other; an event without the state after it is not yet. */
static int count_records(dal_journal *self, size_t length, dal_error *error)
{
    const size_t size = self->size;
    dal__tag last = {0};
    for (size_t whole = self->capacity; whole == self->capacity; self->records += whole) {
        size_t got;
        const int status = read_at(self->file, self->path, self->begin + self->records * size,
                                   self->block, self->capacity * size, &got, error);
        if (status) return status;
        for (whole = 0; whole < got / size; whole++) {
            const unsigned char *const record = self->block + whole * size;
            if (!is_whole(self, self->records + whole, record, size)) break;
            memcpy(&last, record, sizeof last);
        }
    }
    if (last.kind == DAL_RECORD_RESET) self->records--;
    self->written = self->records;
    const size_t end = self->begin + self->records * size;
    self->cut = length > end ? length - end : 0;
    return DAL_SUCCESS;
}

/* The rest of an open file, in memory. */
static int take_in(dal_journal *self, size_t length, dal_error *error)
{
    const size_t described = (size_t)self->head.description_size;
    size_t found;
    int status = read_at(self->file, self->path, self->description_at, self->description,
                         described, &found, error);
    if (status) return status;
    if (found < described || of_head(self) != self->head.checksum)
        return dal__fail(error, DAL_EINVAL, "%s: the header is damaged", self->path);
    status = read_at(self->file, self->path, self->writer_at, self->writer, DAL__WRITER, &found,
                     error);
    if (!status) status = count_records(self, length, error);
    return status;
}

static int lock(dal_journal *self, dal_error *error)
{
    const bool is_free = take_lock(self, self->writes ? LOCK_EX : LOCK_SH);
    self->is_written = !is_free && errno == EWOULDBLOCK;
    if (!self->writes) {
        if (is_free) flock(self->file, LOCK_UN);
        return DAL_SUCCESS;
    }
    if (is_free) return DAL_SUCCESS;
    if (!self->is_written) return fail_io(error, self->path, "locking");
    return dal__fail(error, DAL_EINVAL, "%s: %.*s writes it", self->path, (int)DAL__WRITER,
                     self->writer);
}

int dal__journal_attach(dal_journal **journal, const char *path, bool writes, dal_error *error)
{
    const int file = open(path, (writes ? O_RDWR : O_RDONLY) | O_CLOEXEC);
    if (file < 0) return fail_io(error, path, "opening");
    dal__head head;
    dal_journal *self = NULL;
    size_t length = 0;
    int status = read_head(file, path, &head, &length, error);
    if (!status) status = dal__journal_allocate(&self, path, &head, NULL, error);
    if (status) {
        close(file);
        return status;
    }
    self->file = file;
    self->writes = writes;
    self->saved_at = dal__clock();
    status = take_in(self, length, error);
    if (!status) status = lock(self, error);
    if (!status && writes) status = sign(self, error);
    if (status) dal__journal_detach(self);
    else *journal = self;
    return status;
}

int dal__journal_cut(dal_journal *self)
{
    const off_t end = (off_t)(self->begin + self->records * self->size);
    if (ftruncate(self->file, end)) return fail_io(&self->error, self->path, "truncating");
    return DAL_SUCCESS;
}

/* ---- records ------------------------------------------------------------------------------- */

const unsigned char *dal__journal_record(dal_journal *self, size_t index)
{
    size_t found;
    if (index < self->read_at || index >= self->read_at + self->read_count) {
        self->read_count = 0;
        if (read_at(self->file, self->path, self->begin + index * self->size, self->block,
                    self->capacity * self->size, &found, &self->error)) return NULL;
        self->read_at = index;
        self->read_count = found / self->size;
    }
    const unsigned char *const record = self->block + (index - self->read_at) * self->size;
    if (self->read_count > 0 && is_whole(self, index, record, self->size)) return record;
    dal__fail(&self->error, DAL_EIO, "%s: record %zu has changed since the file was opened",
              self->path, index);
    return NULL;
}

double *dal__journal_next(dal_journal *self, dal_record_kind kind, size_t number, size_t step)
{
    const dal__tag tag = {.kind = kind, .number = number, .step = step};
    memset(self->line, 0, self->size);
    memcpy(self->line, &tag, sizeof tag);
    return (double *)(void *)(self->line + sizeof tag);
}

/* Whether the file is still the one of that name. */
static int look_for(dal_journal *self)
{
    struct stat here, there;
    if (fstat(self->file, &here) == 0 && stat(self->path, &there) == 0
        && here.st_dev == there.st_dev && here.st_ino == there.st_ino) return DAL_SUCCESS;
    return dal__fail(&self->error, DAL_EIO, "%s: the file was removed or replaced", self->path);
}

/* What a run is told when the file is no longer written. */
static int answer(const dal_journal *self)
{
    return self->goes_on && self->error.status == DAL_EIO ? DAL_SUCCESS : self->error.status;
}

/* The end of writing.  A record that is there in part is cut off, or else its checksum tells. */
static int give_up(dal_journal *self)
{
    const int kept = ftruncate(self->file, (off_t)(self->begin + self->written * self->size));
    (void)kept;
    self->records = self->written;
    return answer(self);
}

int dal__journal_flush(dal_journal *self)
{
    if (self->error.status) return answer(self);
    const size_t count = self->records - self->written;
    if (count == 0) return DAL_SUCCESS;
    int status = look_for(self);
    if (!status)
        status = write_at(self, self->begin + self->written * self->size, self->block,
                          count * self->size, &self->error);
    if (status) return give_up(self);
    self->written = self->records;
    return DAL_SUCCESS;
}

/* A record that the file has already is the one that it has. */
static int compare(dal_journal *self)
{
    const unsigned char *const there = dal__journal_record(self, self->records);
    if (!there) return self->error.status;
    if (memcmp(there, self->line, self->size) != 0) {
        dal__tag tag;
        memcpy(&tag, self->line, sizeof tag);
        return dal__fail(&self->error, DAL_EINVAL, "%s: record %zu (kind %u, number %zu) differs "
                         "from the recomputed one: the system, its events, its inputs or the "
                         "machine have changed", self->path, self->records, (unsigned)tag.kind,
                         (size_t)tag.number);
    }
    self->records++;
    self->written++;
    return DAL_SUCCESS;
}

int dal__journal_add(dal_journal *self)
{
    if (self->error.status) return answer(self);
    const uint32_t sum = of_part(self, self->records, self->line, self->size);
    memcpy(self->line, &sum, sizeof sum);
    if (self->records < self->expected) return compare(self);
    self->read_count = 0;
    memcpy(self->block + (self->records - self->written) * self->size, self->line, self->size);
    self->records++;
    return self->records - self->written < self->capacity ? DAL_SUCCESS : dal__journal_flush(self);
}

int dal__journal_save(dal_journal *self)
{
    int status = dal__journal_flush(self);
    if (status || self->error.status) return status;
    if (fdatasync(self->file)) status = fail_io(&self->error, self->path, "writing");
    self->mark.serial++;
    self->mark.records = self->records;
    if (!status) status = write_slot(self, &self->error);
    self->saved_at = dal__clock();
    return status ? give_up(self) : DAL_SUCCESS;
}
