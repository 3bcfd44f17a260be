; The memory of arrays in kernels: a formula that returns a new array costs almost nothing.
;
; A control step makes 200 to 300 small arrays. numba's allocation, and its atomic counting of
; references, would take a third of the step. A kernel holds the interpreter's lock, so no other
; thread uses its arrays, and plain operations suffice. A released array of at most 1 kB waits for
; the next array of its class. Larger arrays, arrays from Python, and arrays that the kernel returns
; are released as usual.

; numba's record of an array's memory: count of references, destructor, its argument, address, size,
; and allocator. Here the argument of the destructor marks the arrays of this kernel, the size is
; their class (size in units of 64 bytes), and instead of the count a released array has the address
; of the next released one.
%owner = type { i64, ptr, ptr, ptr, i64, ptr }
@released = private global [17 x ptr] zeroinitializer  ; the first released array of each class
declare ptr @NRT_MemInfo_alloc_safe_aligned(i64, i32)
declare void @NRT_MemInfo_call_dtor(ptr)

define void @NRT_incref(ptr %owner) alwaysinline {
  %none = icmp eq ptr %owner, null
  br i1 %none, label %end, label %count
count:
  %before = load i64, ptr %owner
  %after = add i64 %before, 1
  store i64 %after, ptr %owner
  br label %end
end:
  ret void
}

define void @NRT_decref(ptr %owner) alwaysinline {
  %none = icmp eq ptr %owner, null
  br i1 %none, label %end, label %count
count:
  %before = load i64, ptr %owner
  %after = add i64 %before, -1
  store i64 %after, ptr %owner
  %unused = icmp eq i64 %after, 0
  br i1 %unused, label %last, label %end
last:
  call void @release(ptr %owner)
  br label %end
end:
  ret void
}

define private void @release(ptr %owner) noinline {
  %to_mark = getelementptr %owner, ptr %owner, i64 0, i32 2
  %mark = load ptr, ptr %to_mark
  %own = icmp eq ptr %mark, @released
  br i1 %own, label %keep, label %destroy
keep:
  %to_class = getelementptr %owner, ptr %owner, i64 0, i32 4
  %class = load i64, ptr %to_class
  %first = getelementptr [17 x ptr], ptr @released, i64 0, i64 %class
  %next = load ptr, ptr %first
  store ptr %next, ptr %owner
  store ptr %owner, ptr %first
  ret void
destroy:
  call void @NRT_MemInfo_call_dtor(ptr %owner)
  ret void
}

define ptr @NRT_MemInfo_alloc_aligned(i64 %size, i32 %align) noinline {
  %padded = add i64 %size, 63
  %class = lshr i64 %padded, 6
  %small = icmp ult i64 %class, 17
  br i1 %small, label %seek, label %large
seek:
  %first = getelementptr [17 x ptr], ptr @released, i64 0, i64 %class
  %found = load ptr, ptr %first
  %none = icmp eq ptr %found, null
  br i1 %none, label %new, label %reuse
reuse:
  %next = load ptr, ptr %found
  store ptr %next, ptr %first
  store i64 1, ptr %found
  ret ptr %found
new:
  %rounded = shl i64 %class, 6
  %made = call ptr @NRT_MemInfo_alloc_safe_aligned(i64 %rounded, i32 64)
  %failed = icmp eq ptr %made, null
  br i1 %failed, label %end, label %mark
mark:
  %to_destructor = getelementptr %owner, ptr %made, i64 0, i32 1
  store ptr null, ptr %to_destructor  ; Python can release the array, too
  %to_mark = getelementptr %owner, ptr %made, i64 0, i32 2
  store ptr @released, ptr %to_mark
  %to_class = getelementptr %owner, ptr %made, i64 0, i32 4
  store i64 %class, ptr %to_class
  br label %end
end:
  ret ptr %made
large:
  %other = call ptr @NRT_MemInfo_alloc_safe_aligned(i64 %size, i32 %align)
  ret ptr %other
}
