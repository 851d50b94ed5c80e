from glob import glob

from setuptools import find_packages, setup

NAME = 'humanopts_teach'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={
        NAME: [
            'py.typed',
            '__init__.pyi',
            'report/*.html',
            'report/*.css',
            'report/*.txt',
            'browser/page.*',
            'study/*.yaml',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/launch', glob('launch/*.launch.py')),
        (f'share/{NAME}/viewers', glob('viewers/*')),
    ],
    extras_require={
        'dask': ['dask', 'distributed'],
        'minari': ['minari[arrow]'],
        'parquet': ['pyarrow'],
    },
    entry_points={
        'console_scripts': [
            'humanopts = humanopts_teach.cli:main',
            'diagnostics = humanopts_teach.ros.diagnostics:main',
            'keyboard_teleop = humanopts_teach.ros.keyboard_teleop:main',
            'lesson = humanopts_teach.ros.lesson_node:main',
            'recorder = humanopts_teach.ros.recorder:main',
            'simulated_teacher = humanopts_teach.ros.simulated_teacher:main',
            'views = humanopts_teach.ros.views:main',
        ],
    },
)
