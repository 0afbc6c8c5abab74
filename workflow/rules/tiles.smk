"""Volumes in tiles, rows of the table of samples with `tiles`: each tile of a scale is a job.

The first job, `coarse`, solves all scales that are as small as one tile. The tiles of the next
scale start from its field; `gather` makes their field, from which those of the next scale start.
"""

TILES = "results/tiles"
TILED = tiled(SAMPLES)


wildcard_constraints:
    level=r"\d+",
    number=r"\d+",


rule coarse:
    input:
        files=lambda wildcards: sample_files(TILED[wildcards.sample]),
        code=code("coarse"),
        module=SCRIPTS / "sample_rows.py",
    output:
        f"{TILES}/{{sample}}/plan.json",
    log:
        "logs/tiles/{sample}/coarse.log",
    benchmark:
        "benchmarks/tiles/{sample}/coarse.tsv"
    wildcard_constraints:
        sample="|".join(map(re.escape, TILED)) or "(?!)",
    conda:
        "../envs/eofm.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards: tile_memory(TILED[wildcards.sample]),
        runtime=lambda wildcards: tile_minutes(
            TILED[wildcards.sample], len(numbers(TILED[wildcards.sample], 0))
        ),
    params:
        words=lambda wildcards: [
            "coarse",
            f"--work={TILES}/{wildcards.sample}",
            *sample_words(TILED[wildcards.sample]),
        ],
    script:
        "../scripts/sample_tiles.py"


rule tile:
    input:
        made=lambda wildcards: before_tiles(
            TILES, TILED, wildcards.sample, wildcards.level
        ),
        code=code("tile"),
        module=SCRIPTS / "sample_rows.py",
    output:
        temp(f"{TILES}/{{sample}}/tile_{{level}}_{{number}}.npy"),
        f"{TILES}/{{sample}}/tile_{{level}}_{{number}}.json",
    log:
        "logs/tiles/{sample}/tile_{level}_{number}.log",
    benchmark:
        "benchmarks/tiles/{sample}/tile_{level}_{number}.tsv"
    wildcard_constraints:
        sample="|".join(map(re.escape, TILED)) or "(?!)",
    conda:
        "../envs/eofm.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards: tile_memory(TILED[wildcards.sample]),
        runtime=lambda wildcards: tile_minutes(TILED[wildcards.sample]),
    params:
        words=lambda wildcards: [
            "tile",
            f"{TILES}/{wildcards.sample}",
            f"--level={wildcards.level}",
            f"--number={wildcards.number}",
        ],
    script:
        "../scripts/sample_tiles.py"


rule gather:
    input:
        made=lambda wildcards: [
            f"{TILES}/{wildcards.sample}/plan.json",
            *tile_files(TILES, TILED, wildcards.sample, int(wildcards.level) + 1),
        ],
        code=code("gather"),
        module=SCRIPTS / "sample_rows.py",
    output:
        f"{TILES}/{{sample}}/choice_{{level}}.json",
    log:
        "logs/tiles/{sample}/gather_{level}.log",
    benchmark:
        "benchmarks/tiles/{sample}/gather_{level}.tsv"
    wildcard_constraints:
        sample="|".join(map(re.escape, TILED)) or "(?!)",
    conda:
        "../envs/eofm.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards: tile_memory(TILED[wildcards.sample]),
        runtime=lambda wildcards: tile_minutes(
            TILED[wildcards.sample], len(numbers(TILED[wildcards.sample], 0))
        ),
    params:
        words=lambda wildcards: [
            "gather",
            f"{TILES}/{wildcards.sample}",
            f"--level={int(wildcards.level) + 1}",
        ],
    script:
        "../scripts/sample_tiles.py"


rule gathered:
    input:
        made=lambda wildcards: [
            f"{TILES}/{wildcards.sample}/plan.json",
            *tile_files(TILES, TILED, wildcards.sample, 0),
        ],
        code=code("gather"),
        module=SCRIPTS / "sample_rows.py",
    output:
        f"{OWN}/{{sample}}/state.json",
    log:
        "logs/samples/{sample}.log",
    benchmark:
        "benchmarks/tiles/{sample}/gathered.tsv"
    wildcard_constraints:
        sample="|".join(map(re.escape, TILED)) or "(?!)",
    conda:
        "../envs/eofm.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards: tile_memory(TILED[wildcards.sample]),
        runtime=lambda wildcards: tile_minutes(
            TILED[wildcards.sample], len(numbers(TILED[wildcards.sample], 0))
        ),
    params:
        words=lambda wildcards: [
            "gather",
            f"{TILES}/{wildcards.sample}",
            f"--folder={OWN}/{wildcards.sample}",
        ],
    script:
        "../scripts/sample_tiles.py"
